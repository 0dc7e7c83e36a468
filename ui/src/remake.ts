// A capture's model, made again with other settings: which ones, and what became of it.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { told } from "./do";
import { Part } from "./element";
import { verdict } from "./history";
import { live } from "./live";
import { type Key, t } from "./words";
import { said } from "./words/said";

/** The fields of the form: the setting of each, its range, and what it is without a choice. */
const NUMBERS: [string, Key, number, number, number][] = [
  ["hull.resolution", "remake_resolution", 40, 400, 1],
  ["silhouette.significance", "remake_significance", 1, 20, 0.5],
  ["silhouette.darkest_shadow", "remake_shadow", 0, 0.5, 0.01],
  ["silhouette.smallest_hole_px", "remake_hole", 0, 10_000, 1],
];

class RemakePart extends Part {
  static properties = { capture: {}, message: { state: true }, busy: { state: true } };
  declare capture: string;
  declare message: string;
  declare busy: boolean;

  constructor() {
    super();
    this.capture = "";
    this.message = "";
    this.busy = false;
  }

  private readonly send = async (event: SubmitEvent) => {
    event.preventDefault();
    const settings: Record<string, number | string> = {};
    for (const field of this.querySelectorAll<HTMLInputElement | HTMLSelectElement>("[name]")) {
      if (field.value !== "") settings[field.name] = field.name === "hull.fairing" ? field.value : Number(field.value);
    }
    if (Object.keys(settings).length === 0) {
      this.message = t("remake_nothing");
      return;
    }
    this.busy = true;
    this.message = "";
    try {
      this.message = told(await api.remake(this.capture, settings));
    } catch (error) {
      this.message = error instanceof api.Refused ? error.words() : String(error);
    } finally {
      this.busy = false;
    }
  };

  render(): TemplateResult {
    const remade = live.now()?.remade ?? null;
    return html`
      <details>
        <summary>${t("remake")}</summary>
        <form class="remake" @submit=${this.send}>
          <p class="quiet">${t("remake_hint")}</p>
          ${NUMBERS.map(
            ([name, words, low, high, step]) => html`
              <label for=${name}>${t(words)} (${low} – ${high})</label>
              <input id=${name} name=${name} type="number" min=${low} max=${high} step=${step} inputmode="decimal" />
            `,
          )}
          <label for="hull.fairing">${t("remake_fairing")}</label>
          <select id="hull.fairing" name="hull.fairing">
            <option value="">${t("remake_as_is")}</option>
            <option value="touch">${t("remake_touch")}</option>
            <option value="none">${t("remake_none")}</option>
          </select>
          <button ?disabled=${this.busy}>${t("remake_begin")}</button>
          <p class="told" role="status">${this.message}</p>
        </form>
      </details>
      ${remade && remade.capture === this.capture ? this.made(remade) : nothing}
    `;
  }

  private made(remade: api.Remade): TemplateResult {
    if (!remade.folder || !remade.level) return html`<p data-remade>${t("remake_failed")} ${remade.reasons.map(said).join("; ")}</p>`;
    const [recording, name] = remade.folder;
    return html`<p data-remade>${verdict(remade.level)} <a href="#/history/${recording}/${name}"><bdi>${name}</bdi></a></p>`;
  }
}

customElements.define("scand-remake", RemakePart);
