// A capture's model, made again with other settings: which ones, and what became of it.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { told } from "./do";
import { Part } from "./element";
import { link, verdict } from "./history";
import { live } from "./live";
import { type Key, plain, t } from "./words";
import { said } from "./words/said";

/** The fields of the form: the setting of each, its words and what these mean, its least and largest value and the step
 * between two, and its default. */
const NUMBERS: [string, Key, Key, number, number, number, number][] = [
  ["hull.resolution", "remake_resolution", "remake_resolution_hint", 40, 400, 1, 200],
  ["silhouette.significance", "remake_significance", "remake_significance_hint", 1, 20, 0.5, 4],
  ["silhouette.darkest_shadow", "remake_shadow", "remake_shadow_hint", 0, 0.5, 0.01, 0.12],
  ["silhouette.spill", "remake_spill", "remake_spill_hint", 0, 0.3, 0.01, 0.06],
  ["silhouette.smallest_hole_px", "remake_hole", "remake_hole_hint", 0, 10_000, 1, 40],
];

/** How late a status from before a model was asked for may arrive: the page's process waits so long for one. */
const STATUS_MS = 3000;

/** What the daemon says that models are made with; nothing of a daemon of an earlier version. */
const settings = () => live.now()?.daemon?.models?.settings;

/** What a field stands for that is left empty: the present value, or, where nothing is told, the default. */
function present(name: string, usual: number): string {
  const all = settings();
  if (!all) return t("remake_usual", { value: plain(usual) });
  const value = all[name];
  // The number of cells is not told where their size is configured.
  return typeof value === "number" ? t("remake_configured", { value: plain(value) }) : t("remake_as_is");
}

function presentFairing(): string {
  const value = settings()?.["hull.fairing"];
  if (value !== "touch" && value !== "none") return t("remake_as_is");
  return t("remake_configured", { value: t(`remake_${value}`) });
}

class RemakePart extends Part {
  static properties = { capture: {}, message: { state: true }, waiting: { state: true }, busy: { state: true } };
  declare capture: string;
  declare message: string;
  /** What the daemon said of a model that is to be made, until none is to be made any more. */
  declare waiting: string;
  declare busy: boolean;
  /** When the model was asked for, by the monotonic clock of this browser. */
  private asked = 0;

  constructor() {
    super();
    this.capture = "";
    this.message = "";
    this.waiting = "";
    this.busy = false;
  }

  willUpdate(changed: Map<string, unknown>): void {
    if (changed.has("capture")) [this.message, this.waiting] = ["", ""];
    if (this.waiting !== "" && this.isNoneLeft()) this.waiting = "";
  }

  /** Whether the daemon told, after the model was asked for, that none is to be made again any more. */
  private isNoneLeft(): boolean {
    const daemon = live.now()?.daemon;
    if (!daemon) return false;
    const since = performance.now() - this.asked;
    return daemon.models?.remakes === 0 && daemon.age_ms + live.passed() + STATUS_MS < since;
  }

  private readonly send = async (event: SubmitEvent) => {
    event.preventDefault();
    const chosen: Record<string, number | string> = {};
    for (const field of this.querySelectorAll<HTMLInputElement | HTMLSelectElement>("[name]")) {
      if (field.value !== "") chosen[field.name] = field.name === "hull.fairing" ? field.value : Number(field.value);
    }
    if (Object.keys(chosen).length === 0) {
      this.message = t("remake_nothing");
      return;
    }
    this.busy = true;
    [this.message, this.waiting] = ["", ""];
    try {
      const answer = await api.remake(this.capture, chosen);
      this.asked = performance.now();
      if (answer.type === "ok") this.waiting = t("remake_waits", { words: said(answer.words ?? "") });
      else this.message = told(answer);
    } catch (error) {
      this.message = error instanceof api.Refused ? error.words() : String(error);
    } finally {
      this.busy = false;
    }
  };

  render(): TemplateResult {
    const remade = live.now()?.remade.find(({ capture }) => capture === this.capture);
    return html`
      <details>
        <summary>${t("remake")}</summary>
        <form class="remake" @submit=${this.send}>
          <p class="quiet">${t("remake_hint")}</p>
          ${NUMBERS.map(
            ([name, words, hint, low, high, step, usual]) => html`
              <label for=${name}>${t(words)} (${plain(low)} – ${plain(high)})</label>
              <input
                id=${name}
                name=${name}
                type="number"
                min=${low}
                max=${high}
                step=${step}
                inputmode="decimal"
                placeholder=${present(name, usual)}
                aria-describedby="${name}-hint"
              />
              <p class="quiet" id="${name}-hint">${t(hint)}</p>
            `,
          )}
          <label for="hull.fairing">${t("remake_fairing")}</label>
          <select id="hull.fairing" name="hull.fairing" aria-describedby="hull.fairing-hint">
            <option value="">${presentFairing()}</option>
            <option value="touch">${t("remake_touch")}</option>
            <option value="none">${t("remake_none")}</option>
          </select>
          <p class="quiet" id="hull.fairing-hint">${t("remake_fairing_hint")}</p>
          <button ?disabled=${this.busy}>${t("remake_begin")}</button>
          <p class="told" role="status">${this.message || this.waiting}</p>
        </form>
      </details>
      ${remade ? this.made(remade) : nothing}
    `;
  }

  private made(remade: api.Remade): TemplateResult {
    if (!remade.folder || !remade.level) return html`<p data-remade>${t("remake_failed")} ${remade.reasons.map(said).join("; ")}</p>`;
    const [recording, name] = remade.folder;
    return html`<p data-remade>${verdict(remade.level)} <a href=${link(recording, name)}><bdi>${name}</bdi></a></p>`;
  }
}

customElements.define("scand-remake", RemakePart);
