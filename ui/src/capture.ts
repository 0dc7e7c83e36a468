// One capture: its model, its verdict with the reasons, figures, notes and files.
import { html, nothing, type TemplateResult } from "lit";
import { keyed } from "lit/directives/keyed.js";
import * as api from "./api";
import "./compare";
import { noted } from "./do";
import { Part } from "./element";
import { cut, date, decision, reason, title, verdict } from "./history";
import { live } from "./live";
import "./photographs";
import { PROVENANCES } from "./provenance";
import "./remake";
import { isKey, type Key, number, t } from "./words";
import type { Measured, Mode, Shade, Viewer } from "./viewer";

const MODES: Mode[] = ["textured", "shaded", "provenance", "error"];
const FILES = ["model.glb", "model.ply", "preview.png", "report.json"];
const NONE = { captures: [], whole: true };

interface Model {
  watertight?: boolean;
  mesh?: { triangles?: number; volume?: number };
  bounds?: [number[], number[]];
  provenance?: { provenance: string; share: number; mean_expected_error: number }[];
}

/** Whether this is a capture itself, and not a model of several captures or one that was made again. */
function isCapture(name: string): boolean {
  return !/\.(object|remake-\d+)$/.test(name);
}

/** The capture of which a model was made; null for a model of several captures. */
function captureOf(name: string): string | null {
  return name.endsWith(".object") ? null : name.replace(/\.remake-\d+$/, "");
}

/** Where a part of a surface is from, in words; as the report has it, if another version of scand wrote that. */
function from(provenance: string): string {
  const key = `from_${provenance}`;
  return isKey(key) ? t(key) : provenance;
}

class CapturePart extends Part {
  static properties = {
    recording: {},
    capture: {},
    operator: { type: Boolean },
    summary: { state: true },
    others: { state: true },
    earlier: { state: true },
    left: { state: true },
    problem: { state: true },
    model: { state: true },
    mode: { state: true },
    view: { state: true },
    measuring: { state: true },
    isMeasuring: { state: true },
    scale: { state: true },
  };
  declare recording: string;
  declare capture: string;
  declare operator: boolean;
  declare summary: api.Summary | null;
  declare others: api.Summary[];
  /** Models of the same object in other recordings; `whole` if all of these were looked through. */
  declare earlier: { captures: api.Summary[]; whole: boolean };
  /** How many captures the recording has that are not listed. */
  declare left: number;
  /** Why the capture cannot be shown as it is now. */
  declare problem: string;
  declare model: Model;
  declare mode: Mode;
  declare view: string;
  /** What is said of measuring, and whether a tap on the model measures now. */
  declare measuring: string;
  declare isMeasuring: boolean;
  declare scale: Shade[];
  private viewer: Viewer | null = null;
  private name = "";
  private shown = "";
  /** Of which capture, of which object, other recordings were asked. */
  private related = "";
  /** Numbers of the last question, and of the last one whose answer is shown. */
  private asked = 0;
  private answered = 0;
  /** Which model, in which state, the viewer shows or loads. */
  private loaded = "";
  /** Ends the loading of a model that is not shown any more. */
  private loading = new AbortController();

  constructor() {
    super();
    this.summary = null;
    this.others = [];
    this.earlier = NONE;
    this.left = 0;
    this.problem = "";
    this.model = {};
    this.mode = "textured";
    this.view = "";
    this.measuring = "";
    this.isMeasuring = false;
    this.scale = [];
  }

  willUpdate(): void {
    const name = `${this.recording}/${this.capture}`;
    if (name !== this.name) this.forget(name);
    const wanted = `${name} ${live.now()?.history ?? ""}`;
    if (wanted !== this.shown) {
      this.shown = wanted;
      void this.load();
    }
  }

  disconnectedCallback(): void {
    this.endViewer();
    super.disconnectedCallback();
  }

  /** Nothing of the capture that was shown before stays under the name of the next one. */
  private forget(name: string): void {
    this.name = name;
    this.summary = null;
    this.others = [];
    this.earlier = NONE;
    this.related = "";
    this.left = 0;
    this.problem = "";
    this.model = {};
    this.endViewer();
  }

  private endViewer(): void {
    this.loading.abort();
    this.loading = new AbortController();
    this.viewer?.end();
    this.viewer = null;
    this.loaded = "";
    this.view = "";
    this.measuring = "";
    this.isMeasuring = false;
    this.scale = [];
  }

  private async load(): Promise<void> {
    const asked = ++this.asked;
    const { name, recording, capture } = this;
    // An answer that comes late takes nothing from the capture that is shown by then, or from a newer answer.
    const isLate = () => name !== this.name || asked < this.answered;
    try {
      const { captures, all } = await api.captures(recording);
      if (isLate()) return;
      this.answered = asked;
      this.summary = captures.find((found) => found.capture === capture) ?? null;
      this.others = captures.filter((found) => found.capture !== capture && found.has_model);
      this.left = all - captures.length;
      this.problem = this.summary ? "" : t("capture_not_listed");
      if (!this.summary || this.summary.verdict === "unread") return;
      void this.relate(this.summary);
      const report = await api.report(recording, capture);
      if (!isLate()) this.model = (report.model ?? {}) as Model;
    } catch (error) {
      if (!isLate()) this.problem = error instanceof api.Refused ? error.words() : String(error);
    }
  }

  /** Asks for models of the same object in other recordings, once for each capture that is shown. */
  private async relate({ recording, capture, subject, has_model }: api.Summary): Promise<void> {
    const wanted = `${recording}/${capture} ${subject ?? ""}`;
    if (subject === null || !has_model || wanted === this.related) return;
    this.related = wanted;
    try {
      const found = await api.related(recording, capture);
      if (wanted === this.related) this.earlier = found;
    } catch {
      // It is asked again when something changes at the rig.
      if (wanted === this.related) this.related = "";
    }
  }

  /** Which model is to be shown, in which state: a model of several captures is made anew under the same name. */
  private wanted(): string {
    return this.summary?.has_model ? `${this.name} ${this.summary.model_tag}` : "";
  }

  updated(): void {
    const wanted = this.wanted();
    if (this.loaded === wanted) return;
    this.endViewer();
    const canvas = this.querySelector("canvas");
    if (canvas && wanted !== "") {
      this.loaded = wanted;
      void this.show(canvas, api.file(this.recording, this.capture, "view.glb"), wanted);
    }
  }

  private async show(canvas: HTMLCanvasElement, address: string, wanted: string): Promise<void> {
    this.view = t("viewer_loading");
    const { signal } = this.loading;
    try {
      const { Viewer } = await import("./viewer");
      const opened = await Viewer.open(canvas, address, (told) => this.measured(told), signal);
      // Another model is shown by now.
      if (this.loaded !== wanted) return opened.end();
      this.viewer = opened;
      this.choose(this.mode);
      this.view = "";
      // For whoever waits until the model is there.
      canvas.dataset.loaded = "true";
    } catch (error) {
      if (this.loaded !== wanted) return;
      this.view = t("viewer_failed", { reason: error instanceof Error ? error.message : String(error) });
    }
  }

  private measured(told: Measured): void {
    const isDone = typeof told === "number";
    this.measuring = isDone ? t("measure_result", { mm: number(told, 1) }) : t(`measure_${told}`);
    this.isMeasuring = !isDone;
  }

  private readonly measure = () => {
    if (!this.viewer) return;
    this.isMeasuring = !this.isMeasuring;
    this.viewer.measure(this.isMeasuring);
    this.measuring = this.isMeasuring ? t("measure_first") : "";
  };

  private choose(mode: Mode): void {
    this.mode = mode;
    this.viewer?.show(mode);
    this.scale = this.viewer?.scale(mode) ?? [];
  }

  render(): TemplateResult {
    const { summary } = this;
    return html`
      <p><a href="#/history/${this.recording}">${t("back")}</a></p>
      <h1><bdi>${title(this.capture)}</bdi></h1>
      ${this.problem ? html`<p role="alert">${this.problem}</p>` : nothing}
      ${summary ? this.about(summary) : nothing}
    `;
  }

  private about(summary: api.Summary): TemplateResult {
    const subject = summary.subject ? t("for_object", { subject: summary.subject }) : "";
    const pictured = captureOf(this.capture);
    const time = summary.time_s === null ? "" : date(summary.time_s);
    // A model that was made again has the time of its capture, and not that of its making.
    const when = time && pictured ? t("captured_at", { time }) : time;
    return html`
      <p class="row">${verdict(summary.verdict)} ${decision(summary)} <bdi>${subject}</bdi>
        ${summary.placement ? html`<bdi>${t("lies", { placement: summary.placement })}</bdi>` : nothing} <span class="quiet">${when}</span></p>
      <div class="capture-page">
        ${summary.has_model ? this.viewerPart() : nothing}
        <section>
          ${pictured
            ? html`<scand-photographs .recording=${this.recording} .capture=${pictured}></scand-photographs>`
            : nothing}
          <h2>${t("reasons")}</h2>
          ${summary.reasons.length === 0 ? html`<p>${t("no_reasons")}</p>` : this.reasons(summary)}
          <h2>${t("figures")}</h2>
          ${this.figures()}
          <h2>${t("notes")}</h2>
          ${summary.notes.length === 0 ? html`<p>${t("no_notes")}</p>` : this.notes(summary)}
          ${this.operator && isCapture(this.capture)
            ? html`<scand-say .capture=${this.capture} .decision=${summary.decision}></scand-say>
                <scand-remake .capture=${this.capture}></scand-remake>`
            : nothing}
          <h2>${t("downloads")}</h2>
          <ul class="files">
            ${FILES.filter((name) => summary.has_model || name === "report.json").map((name) => {
              const address = `${api.file(this.recording, this.capture, name)}?download`;
              return html`<li><a href=${address} download>${name}</a></li>`;
            })}
          </ul>
        </section>
      </div>
      ${summary.has_model ? this.comparison(summary) : nothing}
      ${summary.has_preview ? this.preview() : nothing}
    `;
  }

  /** A comparison has the whole width, and nothing beside it that would move when its tables come. */
  private comparison(summary: api.Summary): TemplateResult | typeof nothing {
    const { others, earlier } = this;
    if (others.length === 0 && earlier.captures.length === 0) return nothing;
    return html`<section>
      <scand-compare .summary=${summary} .others=${others} .earlier=${earlier.captures}></scand-compare>
      ${cut(this.left)} ${earlier.whole ? nothing : html`<p class="quiet">${t("compare_cut")}</p>`}
    </section>`;
  }

  private viewerPart(): TemplateResult {
    return html`
      <section aria-label=${t("model")} class="viewer">
        ${keyed(
          this.wanted(),
          html`<canvas tabindex="0" role="application" aria-label=${t("viewer_label")}></canvas>`,
        )}
        <div class="row" role="group" aria-label=${t("view_as")}>
          ${MODES.map(
            (mode) =>
              html`<button aria-pressed=${this.mode === mode} data-mode=${mode} @click=${() => this.choose(mode)}>
                ${t(`view_${mode}` as Key)}
              </button>`,
          )}
          <button aria-pressed=${this.isMeasuring} data-measure @click=${this.measure}>${t("measure")}</button>
          <button aria-label=${t("view_in")} @click=${() => this.viewer?.zoomIn()}>+</button>
          <button aria-label=${t("view_out")} @click=${() => this.viewer?.zoomOut()}>−</button>
          <button data-reset @click=${() => this.viewer?.reset()}>${t("view_reset")}</button>
        </div>
        <p class="told" role="status">${this.view || this.measuring}</p>
        <p class="quiet">${t("viewer_hint")}</p>
        ${this.legend()}
      </section>
    `;
  }

  private legend(): TemplateResult | typeof nothing {
    if (this.scale.length === 0) return nothing;
    return html`
      ${this.mode === "error" ? html`<p class="quiet">${t("error_scale")}</p>` : nothing}
      <ul class="legend">
        ${this.scale.map(
          (shade) => html`<li>
            <svg viewBox="0 0 10 10" aria-hidden="true"><rect width="10" height="10" fill=${shade.color} /></svg>
            ${this.shadeWords(shade)}
          </li>`,
        )}
      </ul>
    `;
  }

  private shadeWords({ value, isOpen }: Shade): string {
    if (this.mode !== "error") return this.provenanceWords(value);
    const mm = number(value, 2);
    return isOpen ? t("error_and_more", { mm }) : mm;
  }

  private provenanceWords(value: number): string {
    return from(PROVENANCES[value] ?? String(value));
  }

  private reasons(summary: api.Summary): TemplateResult {
    return html`<ul>
      ${summary.reasons.map((found) => html`<li data-code=${found.code}>${reason(found)}</li>`)}
    </ul>`;
  }

  private figures(): TemplateResult {
    const { model } = this;
    const rows: [string, string][] = [];
    if (model.bounds) {
      // The rig's frame has z up: the height is last.
      const [low, high] = model.bounds;
      const sizes = high.map((value, axis) => number((value - low[axis]) * 1000, 0));
      rows.push([t("figure_size"), `${sizes.join(" × ")} mm`]);
    }
    if (model.mesh?.volume !== undefined) {
      rows.push([t("figure_volume"), `${number(model.mesh.volume * 1e6, 0)} cm³`]);
    }
    if (model.mesh?.triangles !== undefined) rows.push([t("figure_triangles"), number(model.mesh.triangles, 0)]);
    if (model.watertight !== undefined) rows.push([t("figure_closed"), model.watertight ? t("yes") : t("no")]);
    return html`
      <dl>${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>
      ${model.provenance ? this.shares(model.provenance) : nothing}
    `;
  }

  private shares(provenance: NonNullable<Model["provenance"]>): TemplateResult {
    return html`<table>
      <thead>
        <tr>
          <th scope="col">${t("view_provenance")}</th>
          <th scope="col">${t("figure_share")}</th>
          <th scope="col">${t("figure_mean_error")}</th>
        </tr>
      </thead>
      <tbody>
        ${provenance.filter((part) => part.share > 0).map(
          (part) => html`<tr>
            <th scope="row">${from(part.provenance)}</th>
            <td>${number(part.share * 100, 0)} %</td>
            <td>${number(part.mean_expected_error * 1000, 2)} mm</td>
          </tr>`,
        )}
      </tbody>
    </table>`;
  }

  private notes(summary: api.Summary): TemplateResult {
    return html`<ul>
      ${summary.notes.map((note) => html`<li>${noted(note)}</li>`)}
    </ul>`;
  }

  private preview(): TemplateResult {
    const address = api.file(this.recording, this.capture, "preview.png");
    return html`<section>
      <h2>${t("photographs")}</h2>
      <img class="preview" src=${address} alt=${t("preview_of", { capture: this.capture })} />
    </section>`;
  }
}

customElements.define("scand-capture", CapturePart);
