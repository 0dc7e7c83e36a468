// "Now": the one large sign, what it is about, and what an operator does.
import { html, nothing, type TemplateResult } from "lit";
import { keyed } from "lit/directives/keyed.js";
import * as api from "./api";
import type { Backlog, Changed, Last, Now, ObjectTold } from "./api";
import { platesLimit } from "./configured";
import type { DoPart } from "./do";
import "./do";
import { Part } from "./element";
import { decision, link, verdict } from "./history";
import { live } from "./live";
import { list } from "./reasons";
import { shown, sign } from "./signs";
import { age, counted, isKey, type Key, plain, t } from "./words";
import { isSaid, said, spoken } from "./words/said";

/** Hours after which a verdict calls background pictures old, by the default of `verdict.background_age_h`. */
const PLATES_USUAL_H = 24;
/** Signs of a model that was made: its reasons are in its report. */
const MODELS = ["green", "amber", "red"];

class NowPart extends Part {
  static properties = { operator: { type: Boolean } };
  declare operator: boolean;

  render(): TemplateResult {
    const now = live.now();
    return html`
      ${this.sign(now)}
      <section class="facts" aria-label=${t("state")}>${now ? this.facts(now) : nothing}</section>
      ${now?.object ? object(now.object) : nothing}
      ${this.operator ? html`<scand-do></scand-do>` : html`<p>${t("viewer")}</p>`}
    `;
  }

  private sign(now: Now | null): TemplateResult {
    const name = now?.sign ?? "unknown";
    const look = shown(now);
    const since = now && now.age_ms !== null ? now.age_ms + live.passed() : null;
    const about = [now?.capture ?? "", since === null ? "" : age(since)].filter((text) => text !== "");
    // The form and the words are told as one; a screen reader says them when they change, and when the same happens
    // again.
    const words = keyed(now?.news ?? null, html`<span>${t(`sign_${look}` as Key)}</span>`);
    return html`
      <section class="now sign-${look}" data-sign=${name}>
        ${sign(look)}
        <div>
          <h1><span role="status" aria-live="assertive">${words}</span></h1>
          <p class="hint">${t(hint(look, now))}</p>
          ${this.operator && look === "ready_no_plates" ? html`<scand-plates .take=${this.takePlates}></scand-plates>` : nothing}
          ${now ? reasons(name, now) : nothing}
          <p class="about">${about.join(" · ")}</p>
        </div>
      </section>
    `;
  }

  private readonly takePlates = () => {
    void this.querySelector<DoPart>("scand-do")?.takePlates();
  };

  private facts(now: Now): TemplateResult {
    const daemon = now.daemon;
    if (!daemon) return html``;
    const plates = daemon.plates_age_h;
    return html`
      <ul>
        <li>${daemon.session ? t("session_open", { name: daemon.session }) : t("session_none")}</li>
        ${daemon.captures_left === null ? nothing : html`<li>${counted("captures_left", daemon.captures_left)}</li>`}
        ${daemon.models && !isBehind(now) ? html`<li>${backlog(daemon.models)}</li>` : nothing}
        <li class=${plates === null ? "warning" : ""}>
          ${plates === null ? t("plates_none") : platesAge(plates, daemon.models)}
        </li>
        ${now.last ? html`<li>${this.last(now.last, now.sign)}</li>` : nothing}
        <li class="quiet">${t("updated", { age: age(daemon.age_ms + live.passed()) })}</li>
      </ul>
    `;
  }

  private last(last: Last, shown: string): TemplateResult {
    const name = html`<bdi>${last.capture}</bdi>`;
    const address = link(last.recording ?? "", last.capture);
    const hasModel = [...MODELS, "model_failed"].includes(last.sign) && last.recording !== null;
    const subject = last.subject ? html` (<bdi>${t("for_object", { subject: last.subject })}</bdi>)` : nothing;
    // Where the sign has to say something else, such as that a camera is away, the failure is told here.
    const why = last.sign === "failed" && shown !== "failed" ? last.reasons : [];
    const which = last.is_last === false ? "last_heard" : "last_capture";
    return html`${t(which)}: ${hasModel ? html`<a href=${address}>${name}</a>` : name}${subject},
      ${t(`sign_${last.sign}` as Key)}${last.decision ? html` ${decision(last)}` : nothing}, ${age(last.age_ms + live.passed())}
      ${why.map((text) => html` ${spoken(text)}`)}`;
  }
}

function reasons(name: string, now: Now): TemplateResult | typeof nothing {
  if (!MODELS.includes(name)) return list(now.reasons);
  const { recording, capture } = now;
  return html`<scand-reasons .recording=${recording ?? ""} .capture=${capture} .texts=${now.reasons}></scand-reasons>`;
}

function hint(name: string, now: Now | null): Key {
  const makesNone = name === "safe" && now?.daemon?.models === null;
  return makesNone ? "sign_safe_only_hint" : (`sign_${name}_hint` as Key);
}

/** How old the background pictures are, and from when on models have that as a reason. */
export function platesAge(hours: number, models: Backlog | null): string {
  return `${t("plates_age", { age: age(hours * 3_600_000) })} ${whenOld(models)}`;
}

function whenOld(models: Backlog | null): string {
  // Where no models are made, none has reasons.
  if (models === null) return t("plates_light");
  const limit = platesLimit(models);
  if (limit === null) return t("plates_limit_usual", { n: PLATES_USUAL_H });
  return limit === Infinity ? t("plates_no_limit") : t("plates_limit", { n: plain(limit) });
}

/** Whether the number of models to be made is from before the one that the sign says is being made. */
function isBehind(now: Now): boolean {
  const models = now.daemon?.models;
  return now.sign === "safe" && !!models && models.waiting + models.running.length === 0;
}

export function backlog(models: { waiting: number; running: unknown[]; expected_s: number | null }): string {
  const open = models.waiting + models.running.length;
  const left = open > 0 && models.expected_s !== null ? models.expected_s : null;
  const when = left === null ? "" : `, ${t("models_done_in", { time: age(left * 1000) })}`;
  return t("models_waiting", { n: open }) + when;
}

/** An object of which there are several captures: how these lie, what to show next, and the model of all of them. */
function object(told: ObjectTold): TemplateResult {
  const { registered, fused } = told;
  const isOld = fused !== null && (fused.is_old || (registered !== null && fused.capture !== registered.capture));
  return html`
    <section class="card object" aria-label=${t("object_of", { subject: told.subject })}>
      <h2><bdi>${t("object_of", { subject: told.subject })}</bdi></h2>
      ${registered ? how(registered) : nothing}
      ${fused ? whole(fused, isOld) : nothing}
    </section>
  `;
}

/** How the captures lie, and what to show next; of a capture that does not fit the others, that is not known. */
function how(registered: NonNullable<ObjectTold["registered"]>): TemplateResult {
  const isLost = registered.level === "red" && registered.show_next === null;
  const next = registered.show_next ? t("object_show_next", { side: said(registered.show_next) }) : t("object_shown");
  // Where the catalogue does not have all of the words, how the pose was found comes first in the page's language.
  const held = `held_${registered.held_by ?? ""}`;
  const general = !isSaid(registered.words) && isKey(held) ? t(held) : "";
  return html`
    <p data-registered>
      ${verdict(registered.level)} <bdi>${registered.capture}</bdi>: ${general} ${spoken(registered.words)}
      ${registered.is_old ? older(registered.changed) : nothing}
    </p>
    ${isLost
      ? html`<p class="next">${t("object_lost")}</p>`
      : html`<p>${t("object_unseen", { n: registered.unseen_percent })}</p>
          <p class="next">${next}</p>`}
    ${list(registered.left_out)}
  `;
}

/** That something is from before the last change, and which change that was, as far as it is known. */
function older(changed: Changed | null): TemplateResult {
  const key = `object_older_${changed?.what ?? ""}`;
  const words = changed && isKey(key) ? t(key, { capture: changed.capture }) : t("object_older");
  return html`<span class="quiet">${words}</span>`;
}

/** Which captures the model of an object is made of, as its report tells. While another model is being made, what is
 * known of this one stays. */
class HoldsPart extends Part {
  static properties = {
    recording: {},
    capture: {},
    last: {},
    isOld: { attribute: false },
    found: { state: true },
  };
  declare recording: string;
  declare capture: string;
  /** The capture after which the model was made. */
  declare last: string;
  declare isOld: boolean;
  declare found: string[];
  private model = "";
  /** Which state of the model was asked for. */
  private asked = "";

  constructor() {
    super();
    this.recording = "";
    this.capture = "";
    this.last = "";
    this.isOld = false;
    this.found = [];
  }

  willUpdate(): void {
    const model = `${this.recording}/${this.capture}`;
    if (model !== this.model) this.found = [];
    this.model = model;
    const wanted = this.isOld ? "" : `${model} ${this.last}`;
    if (wanted === this.asked) return;
    this.asked = wanted;
    if (wanted !== "") void this.load(wanted);
  }

  private async load(wanted: string): Promise<void> {
    let found: string[] = [];
    try {
      const report = (await api.report(this.recording, this.capture)) as { fusion?: { captures?: { id: string }[] } };
      found = (report.fusion?.captures ?? []).map(({ id }) => id);
    } catch {
      // The link leads to the model all the same.
    }
    if (wanted === this.asked) this.found = found;
  }

  render(): TemplateResult | typeof nothing {
    if (this.found.length === 0) return nothing;
    return html`<p data-holds-captures>${t("object_holds", { captures: this.found.join(", ") })}</p>`;
  }
}

function whole(fused: NonNullable<ObjectTold["fused"]>, isOld: boolean): TemplateResult {
  const model = fused.folder
    ? html`<a href=${link(fused.folder[0], fused.folder[1])}>${t("object_model")}</a>`
    : t("object_no_model");
  return html`
    <p data-fused>
      ${fused.level ? verdict(fused.level) : nothing} ${model}
      ${isOld ? older(fused.changed) : nothing}
    </p>
    ${fused.folder
      ? html`<scand-holds
          .recording=${fused.folder[0]}
          .capture=${fused.folder[1]}
          .last=${fused.capture}
          .isOld=${isOld}
        ></scand-holds>`
      : nothing}
    ${fused.folder
      ? html`<scand-reasons .recording=${fused.folder[0]} .capture=${fused.folder[1]} .texts=${fused.reasons}></scand-reasons>`
      : list(fused.reasons)}
    ${list(fused.left_out)}
  `;
}

customElements.define("scand-holds", HoldsPart);
customElements.define("scand-now", NowPart);
