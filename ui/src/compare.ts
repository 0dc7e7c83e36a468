// A model's figures beside those of another one, of the same recording or of the same object in another one: verdict,
// size, volume, and expected error.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { Part } from "./element";
import { date, decision, link, title, verdict } from "./history";
import { difference, number, t } from "./words";

interface Model {
  mesh?: { triangles?: number; volume?: number };
  bounds?: [number[], number[]];
  mean_expected_error?: number;
}

type Row = [string, string, string, string];

class ComparePart extends Part {
  static properties = {
    summary: { attribute: false },
    others: { attribute: false },
    earlier: { attribute: false },
    chosen: { state: true },
    models: { state: true },
    error: { state: true },
    apart: { state: true },
    isBusy: { state: true },
    isLarge: { state: true },
  };
  declare summary: api.Summary;
  /** Models of the same recording, and of the same object in other recordings. */
  declare others: api.Summary[];
  declare earlier: api.Summary[];
  declare chosen: string;
  declare models: [Model, Model] | null;
  declare error: string;
  declare apart: [api.Apart, string] | null;
  declare isBusy: boolean;
  /** Whether the picture of the distances is shown as large as it is. */
  declare isLarge: boolean;
  /** What is compared: both models, each in its present state. */
  private pair = "";
  /** Counts what was asked; an answer to anything but the last question is dropped. */
  private asked = 0;
  /** Ends the comparison of surfaces that are not compared any more. */
  private left = new AbortController();

  constructor() {
    super();
    this.others = [];
    this.earlier = [];
    this.chosen = "";
    this.models = null;
    this.error = "";
    this.apart = null;
    this.isBusy = false;
    this.isLarge = false;
  }

  disconnectedCallback(): void {
    this.forget();
    super.disconnectedCallback();
  }

  /** Figures of models that are not shown any more, or were replaced, are forgotten. */
  willUpdate(changed: Map<string, unknown>): void {
    const before = changed.get("summary") as api.Summary | undefined;
    const isAnother = before && (before.recording !== this.summary.recording || before.capture !== this.summary.capture);
    if (isAnother) this.chosen = "";
    const other = this.other();
    if (!other) this.chosen = "";
    const { recording, capture, model_tag } = this.summary;
    const pair = other ? [recording, capture, model_tag, this.value(other), other.model_tag].join(" ") : "";
    if (pair === this.pair) return;
    this.pair = pair;
    this.forget();
    if (other) void this.load(other);
  }

  /** The model that is chosen. */
  private other(): api.Summary | undefined {
    return [...this.others, ...this.earlier].find((other) => this.value(other) === this.chosen);
  }

  /** What stands for a model in the list: of the same recording its name, of another one that too. */
  private value({ recording, capture }: api.Summary): string {
    return recording === this.summary.recording ? capture : `${recording}/${capture}`;
  }

  private forget(): void {
    if (this.apart) URL.revokeObjectURL(this.apart[1]);
    this.apart = null;
    this.models = null;
    this.error = "";
    this.isBusy = false;
    this.isLarge = false;
    this.asked++;
    this.left.abort();
    this.left = new AbortController();
  }

  /** Has the surfaces compared, which takes some seconds. */
  private readonly measure = async () => {
    const { recording, capture } = this.summary;
    const other = this.other();
    if (!other) return;
    this.isBusy = true;
    this.error = "";
    await this.ask(api.difference(recording, capture, other, this.left.signal), ([found, picture]) => {
      this.apart = [found, URL.createObjectURL(picture)];
    });
  };

  updated(): void {
    const dialog = this.querySelector("dialog");
    if (this.isLarge && dialog && !dialog.open) dialog.showModal();
    if (!this.isLarge && dialog?.open) dialog.close();
  }

  private readonly enlarge = () => {
    this.isLarge = true;
  };

  private readonly close = () => {
    this.isLarge = false;
  };

  /** This is told after the closing: the dialog may be open again by then. */
  private readonly closed = (event: Event) => {
    if (!(event.target as HTMLDialogElement).open) this.close();
  };

  private readonly choose = (event: Event) => {
    this.chosen = (event.target as HTMLSelectElement).value;
  };

  private async load(other: api.Summary): Promise<void> {
    const reports = Promise.all([this.summary, other].map(({ recording, capture }) => api.report(recording, capture)));
    await this.ask(reports, (found) => {
      this.models = found.map((report) => (report.model ?? {}) as Model) as [Model, Model];
    });
  }

  /** Takes an answer in, unless something else was asked meanwhile. */
  private async ask<T>(answer: Promise<T>, take: (found: T) => void): Promise<void> {
    const asked = ++this.asked;
    try {
      const found = await answer;
      if (asked === this.asked) take(found);
    } catch (error) {
      if (asked === this.asked) this.error = error instanceof api.Refused ? error.words() : String(error);
    }
    if (asked === this.asked) this.isBusy = false;
  }

  render(): TemplateResult {
    const other = this.other();
    return html`
      <p>
        <label for="compare">${t("compare")}</label>
        <select id="compare" @change=${this.choose}>
          <option value="" .selected=${this.chosen === ""}>–</option>
          ${this.others.map(
            ({ capture, subject }) =>
              html`<option value=${capture} .selected=${capture === this.chosen}>${title(capture)}${subject ? ` (${subject})` : ""}</option>`,
          )}
          ${this.earlier.length > 0
            ? html`<optgroup label=${t("compare_earlier")}>${this.earlier.map((earlier) => this.option(earlier))}</optgroup>`
            : nothing}
        </select>
      </p>
      ${this.error ? html`<p role="alert">${this.error}</p>` : nothing}
      ${other && this.models ? this.table(other, this.models) : nothing}
      ${other && this.models ? this.surfaces(other) : nothing}
    `;
  }

  /** A model of another recording in the list. */
  private option(other: api.Summary): TemplateResult {
    const time = other.time_s === null ? "" : `, ${date(other.time_s)}`;
    const value = this.value(other);
    return html`<option value=${value} .selected=${value === this.chosen}>${other.recording}: ${title(other.capture)}${time}</option>`;
  }

  private surfaces(other: api.Summary): TemplateResult {
    if (!other.has_model || !this.summary.has_model) return html``;
    // The object was put down anew in between.
    const elsewhere = other.recording === this.summary.recording ? nothing : html`<p class="quiet">${t("apart_elsewhere")}</p>`;
    if (!this.apart) {
      return html`${elsewhere}<p><button data-measure-surfaces ?disabled=${this.isBusy} @click=${this.measure}>
        ${t(this.isBusy ? "apart_busy" : "apart_measure")}
      </button></p>`;
    }
    const [found, picture] = this.apart;
    const larger = found.growth_mm >= 0;
    const words = t(larger ? "apart_larger" : "apart_smaller", { mm: number(Math.abs(found.growth_mm), 2) });
    const row = (name: string, key: "a_to_b" | "b_to_a") => {
      const { mean_mm, median_mm, p90_mm, max_mm } = found[key];
      return html`<tr>
        <th scope="row">${name}</th>
        ${[mean_mm, median_mm, p90_mm, max_mm].map((mm) => html`<td>${number(mm, 2)}</td>`)}
      </tr>`;
    };
    return html`
      <table data-apart>
        <caption>${t("apart_caption")}</caption>
        <thead>
          <tr>
            <th scope="col">${t("apart_from")}</th>
            <th scope="col">${t("apart_mean")}</th>
            <th scope="col">${t("apart_median")}</th>
            <th scope="col">${t("apart_p90")}</th>
            <th scope="col">${t("apart_max")}</th>
          </tr>
        </thead>
        <tbody>${row(title(this.summary.capture), "a_to_b")} ${row(title(other.capture), "b_to_a")}</tbody>
      </table>
      <p>${words}</p>
      ${elsewhere}
      ${this.picture(picture, t("apart_picture", { other: title(other.capture) }))}
    `;
  }

  /** The picture of the distances, and the same as large as it is, where its words can be read. */
  private picture(url: string, words: string): TemplateResult {
    return html`
      <p class="quiet">${words}</p>
      <button class="enlarge" aria-label=${t("apart_enlarge")} @click=${this.enlarge}>
        <img class="preview" src=${url} alt="" />
      </button>
      <dialog class="whole" aria-label=${words} @close=${this.closed}>
        <button @click=${this.close}>${t("close")}</button>
        <img src=${url} alt=${words} />
      </dialog>
    `;
  }

  private table(other: api.Summary, [own, others]: [Model, Model]): TemplateResult {
    return html`<table data-compared>
      <thead>
        <tr>
          <th scope="col">${t("figures")}</th>
          <th scope="col"><bdi>${title(this.summary.capture)}</bdi></th>
          <th scope="col"><a href=${link(other.recording, other.capture)}><bdi>${title(other.capture)}</bdi></a></th>
          <th scope="col">${t("difference")}</th>
        </tr>
      </thead>
      <tbody>
        <tr>
          <th scope="row">${t("verdict")}</th>
          <td>${verdict(this.summary.verdict)} ${decision(this.summary)}</td>
          <td>${verdict(other.verdict)} ${decision(other)}</td>
          <td></td>
        </tr>
        ${rows(own, others).map(
          ([name, ...cells]) => html`<tr>
            <th scope="row">${name}</th>
            ${cells.map((cell) => html`<td>${cell}</td>`)}
          </tr>`,
        )}
      </tbody>
    </table>
    <p class="quiet">${t("compare_hint")}</p>`;
  }
}

/** Each figure that both have: its name, both values, and by how much the second is larger. */
function rows(own: Model, other: Model): Row[] {
  const found: Row[] = [];
  const add = (name: string, a: number | undefined, b: number | undefined, digits: number, unit: string) => {
    if (a === undefined || b === undefined) return;
    const percent = a === 0 ? "" : ` (${difference((100 * (b - a)) / a, 1)} %)`;
    const [ownValue, otherValue] = [a, b].map((value) => `${number(value, digits)} ${unit}`);
    found.push([name, ownValue, otherValue, `${difference(b - a, digits)} ${unit}${percent}`]);
  };
  const side = (model: Model, axis: number) => model.bounds && (model.bounds[1][axis] - model.bounds[0][axis]) * 1000;
  // The rig's frame has z up.
  for (const [axis, name] of (["figure_width", "figure_depth", "figure_height"] as const).entries()) {
    add(t(name), side(own, axis), side(other, axis), 1, "mm");
  }
  const volume = ({ mesh }: Model) => (mesh?.volume === undefined ? undefined : mesh.volume * 1e6);
  add(t("figure_volume"), volume(own), volume(other), 1, "cm³");
  const error = ({ mean_expected_error: metres }: Model) => (metres === undefined ? undefined : metres * 1000);
  add(t("figure_mean_error"), error(own), error(other), 2, "mm");
  return found;
}

customElements.define("scand-compare", ComparePart);
