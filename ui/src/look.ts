// "Look": what the cameras see while the rig is set up. Pictures are asked for only while this part is shown. When nothing
// was heard for ten seconds, none is shown; one that is older than the cameras' turns explain has a warning.
import { html, nothing, svg, type SVGTemplateResult, type TemplateResult } from "lit";
import * as api from "./api";
import { type Moment, moment, since } from "./clock";
import { Part } from "./element";
import { age, type Key, number, t } from "./words";
import { said } from "./words/said";

/** From when on a picture is old, however few cameras there are. */
const OLD_MS = 5_000;
/** Longest time that one camera's turn takes while all is well: a whole picture of a camera on a slow link. */
const TURN_MS = 1_500;
const GONE_MS = 10_000;
const AGAIN_MS = 1_000;
/** Clipped pixels in a million from which they are worth a warning. */
const CLIPPED_PPM = 100;
/** How much less sharp than the last good capture a picture may be, in percent. */
const LESS_SHARP = 10;

interface Shown {
  camera: string;
  look: api.CameraLook;
  url: string | null;
  /** When it arrived, at the age that it has. */
  at: Moment;
}

class LookPart extends Part {
  static properties = { problem: { state: true }, large: { state: true }, good: { state: true } };
  declare problem: string;
  declare large: string;
  declare good: Record<string, number>;
  private readonly shown = new Map<string, Shown>();
  private isShown = false;
  private number = 0;
  private heard = moment();

  constructor() {
    super();
    this.problem = "";
    this.large = "";
    this.good = {};
  }

  connectedCallback(): void {
    super.connectedCallback();
    this.isShown = true;
    void this.run();
  }

  disconnectedCallback(): void {
    this.isShown = false;
    this.forget();
    super.disconnectedCallback();
  }

  private async run(): Promise<void> {
    this.heard = moment();
    while (this.isShown) {
      if (document.hidden) {
        await pause(AGAIN_MS);
        continue;
      }
      try {
        this.take(await api.look(this.number));
      } catch (error) {
        this.problem = error instanceof api.Refused ? error.words() : String(error);
        await pause(AGAIN_MS);
      }
      this.requestUpdate();
    }
  }

  private take(found: api.Look): void {
    this.heard = moment();
    this.problem = found.problem ?? "";
    this.good = found.good;
    if (found.problem || found.number < this.number) this.forget();
    this.number = found.number;
    if (!this.isShown) return;
    for (const [camera, look] of Object.entries(found.cameras)) {
      const url = look.picture ? URL.createObjectURL(blob(look.picture)) : null;
      this.drop(camera);
      this.shown.set(camera, { camera, look, url, at: this.heard });
    }
  }

  private drop(camera: string): void {
    const url = this.shown.get(camera)?.url;
    if (url) URL.revokeObjectURL(url);
    this.shown.delete(camera);
  }

  /** A picture that was made large stands where the person looks. */
  updated(changed: Map<string, unknown>): void {
    if (changed.has("large") && this.large !== "") this.querySelector(".look.large")?.scrollIntoView({ block: "start" });
  }

  /** From when on a picture is older than the turns of so many cameras make it. */
  private oldMs(): number {
    return Math.max(OLD_MS, this.shown.size * TURN_MS);
  }

  private forget(): void {
    for (const camera of [...this.shown.keys()]) this.drop(camera);
  }

  render(): TemplateResult {
    if (since(this.heard) > GONE_MS) this.forget();
    const all = [...this.shown.values()].sort((a, b) => a.camera.localeCompare(b.camera));
    return html`
      <h1>${t("look")}</h1>
      <p>${t("look_hint")}</p>
      ${this.problem ? html`<p role="alert">${t("look_problem", { reason: said(this.problem) })}</p>` : nothing}
      ${all.length === 0 && !this.problem ? html`<p role="status">${t("look_waiting")}</p>` : nothing}
      <svg class="defs" aria-hidden="true" focusable="false">
        <pattern id="hatch" width="8" height="8" patternUnits="userSpaceOnUse">
          <rect width="8" height="8" class="light" /><path d="M0 8L8 0" class="dark" />
        </pattern>
      </svg>
      <ul class="looks">${all.map((shown) => this.card(shown))}</ul>
    `;
  }

  private card(shown: Shown): TemplateResult {
    const { camera, look, url } = shown;
    const isLarge = this.large === camera;
    const passed = since(shown.at) + look.age_ms;
    const turn = () => {
      this.large = isLarge ? "" : camera;
    };
    return html`
      <li class="card look ${isLarge ? "large" : ""}" data-camera=${camera}>
        <h2><bdi>${camera}</bdi></h2>
        ${url && look.seen
          ? html`
              <div class="picture">
                <img src=${url} alt=${t("look_alt", { camera })} width=${look.seen.width} height=${look.seen.height} />
                ${overlay(look.seen)}
              </div>
              <ul class="facts-of">${this.facts(camera, look.seen, passed)}</ul>
              <p class=${passed > this.oldMs() ? "warning" : "quiet"}>${t("look_age", { age: seconds(passed) })}</p>
              <button aria-pressed=${isLarge} @click=${turn}>${t("look_large")}</button>
            `
          : html`<p class="warning">${t("look_none", { reason: said(look.words ?? "") })}</p>`}
      </li>
    `;
  }

  private facts(camera: string, seen: api.Seen, passed: number): TemplateResult[] {
    const facts: TemplateResult[] = [];
    const say = (isFine: boolean, words: string) =>
      facts.push(html`<li class=${isFine ? "" : "warning"}>${isFine ? "✓" : "⚠"} ${words}</li>`);
    if (seen.clipped_ppm !== undefined) {
      const percent = number(seen.clipped_ppm / 10_000, seen.clipped_ppm < 10_000 ? 2 : 0);
      say(seen.clipped_ppm < CLIPPED_PPM, t("look_clipped", { percent }));
    }
    const good = this.good[camera];
    if (seen.sharpness_percent !== undefined) {
      const n = seen.sharpness_percent;
      if (good === undefined) say(true, t("look_sharpness", { n }));
      else say(n + LESS_SHARP >= good, t("look_sharpness_good", { n, good }));
    }
    if (seen.is_binned) facts.push(html`<li>${measured(seen, passed)}</li>`);
    const touches = seen.touches ?? [];
    if (touches.length > 0) {
      const sides = touches.map((side) => t(`side_${side}` as Key)).join(", ");
      say(false, t("look_touches", { sides }));
    } else if (seen.outline) say(true, t("look_inside"));
    if (seen.no_outline) say(false, t("look_no_outline", { reason: said(seen.no_outline) }));
    if (seen.readings_percent !== undefined) say(true, t("look_readings", { n: seen.readings_percent }));
    if (seen.why_whole) facts.push(html`<li>${said(seen.why_whole)}</li>`);
    return facts;
  }
}

/** How old the figures are that a small picture cannot show, in words. */
function measured(seen: api.Seen, passed: number): string {
  if (seen.measured_before_ms === undefined) return t("look_not_measured");
  return t("look_measured", { age: seconds(seen.measured_before_ms + passed) });
}

/** The outline and what is clipped, over a picture. */
function overlay(seen: api.Seen): TemplateResult {
  const path = (polygons: api.Polygon[]) => polygons.map((points) => `M${points.map((p) => p.join(" ")).join("L")}Z`).join("");
  const outline: SVGTemplateResult | typeof nothing = seen.outline
    ? svg`<path class="under" d=${path(seen.outline)} /><path class="outline" d=${path(seen.outline)} />`
    : nothing;
  return html`<svg viewBox="0 0 ${seen.width} ${seen.height}" aria-hidden="true" focusable="false">
    <path class="clipped" fill="url(#hatch)" fill-rule="evenodd" d=${path(seen.clipped ?? [])} />${outline}
  </svg>`;
}

function seconds(ms: number): string {
  return ms < 10_000 ? t("age_seconds", { n: number(ms / 1000, 1) }) : age(ms);
}

function pause(ms: number): Promise<void> {
  return new Promise((done) => setTimeout(done, ms));
}

function blob(base64: string): Blob {
  const text = atob(base64);
  const bytes = Uint8Array.from(text, (character) => character.charCodeAt(0));
  return new Blob([bytes], { type: "image/jpeg" });
}

customElements.define("scand-look", LookPart);
