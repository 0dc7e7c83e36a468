// "History": recordings, and the captures of one as a strip of previews with their verdicts.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { moment, since } from "./clock";
import { Part } from "./element";
import { live } from "./live";
import { sign } from "./signs";
import { age, isKey, type Key, language, t } from "./words";
import { said, spoken } from "./words/said";

/** Where a capture's or an object's model is shown. The name of an object's folder has some characters of its number as %XX. */
export function link(recording: string, capture: string): string {
  return `#/history/${encodeURIComponent(recording)}/${encodeURIComponent(capture)}`;
}

export function date(seconds: number): string {
  const format = new Intl.DateTimeFormat(language(), { dateStyle: "medium", timeStyle: "short" });
  return format.format(new Date(seconds * 1000));
}

/** A verdict as sign, word and colour. */
export function verdict(name: string): TemplateResult {
  const form = name === "failed" ? "model_failed" : name;
  return html`<span class="verdict sign-${form}">${sign(form)} ${t(`verdict_${name}` as Key)}</span>`;
}

/** A reason of a verdict: what its code means in the page's language, and what the daemon says of it. If one of these
 * has the other in it, it stands alone. */
export function reason(found: api.Reason): TemplateResult {
  const general = generally(found.code);
  const [meant, told] = [general, said(found.words)].map(plain);
  if (told.includes(meant)) return spoken(found.words);
  if (meant.includes(told)) return html`${general}`;
  return html`${general} <span class="quiet">${spoken(found.words)}</span>`;
}

/** A sentence as it may stand within another one. */
function plain(sentence: string): string {
  return sentence.toLowerCase().replace(/\.$/, "");
}

/** What a code means, if this page knows it. */
export function generally(code: string): string {
  const key = `reason_${code}`;
  return isKey(key) ? t(key) : "";
}

/** Says how many are not listed, if any are not. */
export function cut(left: number): TemplateResult | typeof nothing {
  return left > 0 ? html`<p class="quiet" data-cut>${t("list_cut", { n: left })}</p>` : nothing;
}

class HistoryPart extends Part {
  static properties = {
    recording: {},
    names: { state: true },
    captures: { state: true },
    left: { state: true },
    seen: { state: true },
    error: { state: true },
  };
  declare recording: string;
  declare names: { name: string; changed_s: number }[] | null;
  declare captures: api.Summary[];
  /** How many recordings, and captures of the chosen one, are not listed. */
  declare left: [number, number];
  declare seen: api.Last[];
  declare error: string;
  private shown = "";
  /** Which recording the captures are of. */
  private listed = "";
  /** When the ages of what is in progress were told. */
  private heard = moment();
  /** Numbers of the last question, and of the last one whose answer is shown. */
  private asked = 0;
  private answered = 0;

  constructor() {
    super();
    this.recording = "";
    this.names = null;
    this.captures = [];
    this.left = [0, 0];
    this.seen = [];
    this.error = "";
  }

  /** Asks again when what it shows changed at the rig. */
  willUpdate(): void {
    const wanted = `${this.recording} ${live.now()?.history ?? ""}`;
    if (wanted !== this.shown) {
      this.shown = wanted;
      void this.load();
    }
    // What is listed of one recording does not stand under another's name.
    if (this.listed === this.chosen()) return;
    this.captures = [];
    this.left = [this.left[0], 0];
  }

  private chosen(): string {
    return this.recording || this.names?.[0]?.name || "";
  }

  private async load(): Promise<void> {
    const asked = ++this.asked;
    const { recording } = this;
    // An answer that comes late takes nothing from the recording that is shown by then, or from a newer answer.
    const isLate = () => recording !== this.recording || asked < this.answered;
    try {
      const found = await api.recordings();
      const chosen = recording || found.recordings[0]?.name || "";
      const listed = chosen === "" ? { captures: [], all: 0 } : await api.captures(chosen);
      if (isLate()) return;
      this.answered = asked;
      this.names = found.recordings;
      this.listed = chosen;
      this.captures = listed.captures;
      this.left = [found.all - found.recordings.length, listed.all - listed.captures.length];
      this.heard = moment();
      this.seen = found.seen.filter((seen) => !["green", "amber", "red"].includes(seen.sign));
      this.error = "";
    } catch (error) {
      if (!isLate()) this.error = error instanceof api.Refused ? error.words() : String(error);
    }
  }

  render(): TemplateResult {
    const chosen = this.chosen();
    return html`
      <h1>${t("history")}</h1>
      ${this.error ? html`<p role="alert">${this.error}</p>` : nothing}
      ${this.seen.length > 0 ? this.open() : nothing}
      ${this.names?.length === 0 ? html`<p>${t("no_captures")}</p>` : nothing}
      ${chosen ? this.strip(chosen) : nothing}
    `;
  }

  private open(): TemplateResult {
    const passed = since(this.heard);
    return html`
      <h2>${t("in_progress")}</h2>
      <ul class="open">
        ${this.seen.map(
          (seen) => html`<li>
            ${sign(seen.sign)} <bdi>${seen.capture}</bdi> ${seen.subject ? html`(<bdi>${seen.subject}</bdi>)` : nothing},
            ${t(`sign_${seen.sign}` as Key)}, ${age(seen.age_ms + passed)} ${seen.reasons.map(said).join("; ")}
          </li>`,
        )}
      </ul>
    `;
  }

  private strip(chosen: string): TemplateResult {
    const go = (event: Event) => {
      location.hash = `#/history/${(event.target as HTMLSelectElement).value}`;
    };
    const listed = this.names?.map(({ name }) => name) ?? [];
    // One that is too old to be listed is shown all the same.
    const names = listed.includes(chosen) ? listed : [chosen, ...listed];
    return html`
      <p>
        <label for="recording">${t("recording")}</label>
        <select id="recording" @change=${go}>
          ${names.map((name) => html`<option value=${name} .selected=${name === chosen}>${name}</option>`)}
        </select>
      </p>
      ${cut(this.left[0])}
      <h2>${t("captures_of", { recording: chosen })}</h2>
      <ul class="strip">
        ${this.captures.map((capture) => html`<li>${this.card(capture)}</li>`)}
      </ul>
      ${cut(this.left[1])}
    `;
  }

  private card(capture: api.Summary): TemplateResult {
    const picture = api.file(capture.recording, capture.capture, "thumbnail.jpg");
    const first = capture.reasons[0];
    const words = first && (generally(first.code) || said(first.words));
    return html`
      <a class="card capture" href=${link(capture.recording, capture.capture)}>
        ${capture.has_preview
          ? html`<img loading="lazy" decoding="async" src=${picture} alt=${t("preview_of", { capture: capture.capture })} />`
          : nothing}
        <span>${verdict(capture.verdict)} ${decision(capture)}</span>
        <strong><bdi>${title(capture.capture)}</bdi></strong>
        ${capture.subject ? html`<span><bdi>${t("for_object", { subject: capture.subject })}</bdi></span>` : nothing}
        ${capture.time_s !== null ? html`<span class="quiet">${date(capture.time_s)}</span>` : nothing}
        ${words ? html`<span class="quiet">${words}</span>` : nothing}
      </a>
    `;
  }
}

/** What a model is called: a capture by its name, a model of several captures as what it is. */
export function title(name: string): string {
  if (name.endsWith(".object")) return t("title_object");
  const remake = /^(.*)\.remake-(\d+)$/.exec(name);
  return remake ? t("title_remake", { capture: remake[1], n: remake[2] }) : name;
}

export function decision(capture: { decision?: string | null }): TemplateResult | typeof nothing {
  const known = ["accepted", "rejected"].includes(capture.decision ?? "");
  return known ? html`<span class="decision">${t(`decision_${capture.decision}` as Key)}</span>` : nothing;
}

customElements.define("scand-history", HistoryPart);
