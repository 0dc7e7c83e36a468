// Lists of reasons as the daemon told them, each in the page's language as far as the catalogue has it. Of a model's
// reasons the daemon tells the words alone; what each is about, by its code, is in the model's report.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { Part } from "./element";
import { generally } from "./history";
import { isSaid, spoken } from "./words/said";

const LONGEST_LIST = 6;

/** A list of what the daemon said, cut at a length. */
export function list(texts: string[], words: (text: string) => TemplateResult = spoken): TemplateResult | typeof nothing {
  if (texts.length === 0) return nothing;
  const shown = texts.slice(0, LONGEST_LIST);
  return html`<ul class="reasons">
    ${shown.map((text) => html`<li>${words(text)}</li>`)} ${texts.length > shown.length ? html`<li>…</li>` : nothing}
  </ul>`;
}

/** A model's reasons as the daemon said them. Before one that the catalogue does not have as a whole, it says what the
 * code means, once the report was read. */
class ReasonsPart extends Part {
  static properties = { recording: {}, capture: {}, texts: { attribute: false }, found: { state: true } };
  declare recording: string;
  declare capture: string;
  declare texts: string[];
  declare found: api.Reason[];
  /** Which reasons of which model were asked for. */
  private asked = "";

  constructor() {
    super();
    this.recording = "";
    this.capture = "";
    this.texts = [];
    this.found = [];
  }

  /** Asks for the codes, unless all of the daemon's words are in the page's language anyway. */
  willUpdate(): void {
    const isWanted = this.recording !== "" && this.capture !== "" && !this.texts.every(isSaid);
    const wanted = isWanted ? [this.recording, this.capture, ...this.texts].join("\n") : "";
    if (wanted === this.asked) return;
    this.asked = wanted;
    this.found = [];
    if (isWanted) void this.load(wanted);
  }

  private async load(wanted: string): Promise<void> {
    try {
      const report = (await api.report(this.recording, this.capture)) as { verdict?: { reasons?: api.Reason[] } };
      if (wanted === this.asked) this.found = report.verdict?.reasons ?? [];
    } catch {
      // The daemon's own words stay.
    }
  }

  render(): TemplateResult | typeof nothing {
    return list(this.texts, (text) => this.reason(text));
  }

  private reason(text: string): TemplateResult {
    const code = this.found.find(({ words }) => words === text)?.code ?? "";
    const general = isSaid(text) ? "" : generally(code);
    return general ? html`${general} (${spoken(text)})` : spoken(text);
  }
}

customElements.define("scand-reasons", ReasonsPart);
