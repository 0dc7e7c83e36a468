// "Do": press, the object's number, background pictures, sessions, and what people say of the last capture.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { Part } from "./element";
import { date } from "./history";
import { live } from "./live";
import { press, type Pressed, resume } from "./press";
import { shown } from "./signs";
import { isKey, type Key, t } from "./words";
import { said } from "./words/said";

/** What an answer says, in the page's language. */
export function told(answer: api.Answer): string {
  const capture = answer.capture ?? "";
  const reason = said(answer.reason ?? "");
  switch (answer.type) {
    case "durable":
      return t("told_durable", { capture });
    case "busy":
      return t("told_busy");
    case "failed":
      return t("told_failed", { reason });
    case "refused":
      return t("told_refused", { reason });
    case "ending":
      return t("told_ending");
    default:
      return t("told_ok", { words: said(answer.words ?? answer.type) });
  }
}

const AUTHOR = "scand-operator";
/** The session that was begun on this tablet under that name. */
const SESSION = "scand-session";

/** Who notes something, as far as that is known: the operator of the session, if it was begun on this tablet. */
function author(): string {
  const session = live.now()?.daemon?.session ?? null;
  const isOwn = session !== null && session === localStorage.getItem(SESSION);
  return isOwn ? (localStorage.getItem(AUTHOR) ?? "") : "";
}

/** How an object often lies; any other words do as well. */
const PLACEMENTS: Key[] = ["placement_upright", "placement_side", "placement_other_side", "placement_upside_down"];

/** The button for background pictures, which asks whether the rig is empty before it takes them. */
class PlatesPart extends Part {
  static properties = { take: { attribute: false }, disabled: { type: Boolean }, asking: { state: true } };
  declare take: () => void;
  declare disabled: boolean;
  declare asking: boolean;

  constructor() {
    super();
    this.take = () => {};
    this.disabled = false;
    this.asking = false;
  }

  private readonly confirmed = () => {
    this.asking = false;
    this.take();
  };

  render(): TemplateResult {
    if (this.asking) return this.confirm();
    const ask = () => (this.asking = true);
    return html`<button ?disabled=${this.disabled} @click=${ask}>${t("plates_ask")}</button>`;
  }

  private confirm(): TemplateResult {
    const cancel = () => (this.asking = false);
    return html`
      <p>${t("plates_confirm")}</p>
      <p class="row">
        <button ?disabled=${this.disabled} @click=${this.confirmed}>${t("plates_yes")}</button>
        <button @click=${cancel}>${t("cancel")}</button>
      </p>
    `;
  }
}

export class DoPart extends Part {
  static properties = { message: { state: true }, busy: { state: true }, pressing: { state: true } };
  declare message: string;
  /** Whether an answer is waited for. */
  declare busy: boolean;
  /** Whether it is that to a press. */
  declare pressing: boolean;

  constructor() {
    super();
    this.message = "";
    this.busy = false;
    this.pressing = false;
  }

  connectedCallback(): void {
    super.connectedCallback();
    document.addEventListener("keydown", this.toNumber);
    const pending = resume();
    if (pending) void this.pressed(pending);
  }

  disconnectedCallback(): void {
    document.removeEventListener("keydown", this.toNumber);
    super.disconnectedCallback();
  }

  firstUpdated(): void {
    this.number()?.focus({ preventScroll: true });
  }

  /** A scanner types wherever the focus is, such as on the button that was tapped last: what no other field takes goes
   * into that of the number. */
  private readonly toNumber = (event: KeyboardEvent) => {
    const isText = event.key.length === 1 && event.key !== " " && !event.ctrlKey && !event.altKey && !event.metaKey;
    if (!isText || document.activeElement?.matches("input, select, textarea")) return;
    const field = this.number();
    field?.focus();
    field?.select();
  };

  private number(): HTMLInputElement | null {
    return this.querySelector<HTMLInputElement>("#number");
  }

  private value(id: string): string {
    return this.querySelector<HTMLInputElement>(`#${id}`)?.value.trim() ?? "";
  }

  /** Enter confirms the number: the next one that is scanned or typed replaces it. */
  private readonly entered = (event: KeyboardEvent) => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    this.number()?.select();
  };

  private readonly press = () => {
    if (this.busy) return;
    // Who presses looks at the sign next.
    scrollTo({ top: 0 });
    void this.pressed(press(this.value("number"), this.value("placement")));
  };

  private async pressed({ subject, placement, answer }: Pressed): Promise<void> {
    this.pressing = true;
    const isTaken = await this.during(answer, (error) => {
      const isUnsure = error instanceof api.Refused && error.code === "network";
      return isUnsure ? t("told_unsure") : null;
    });
    this.pressing = false;
    // The next one may lie otherwise. What was typed meanwhile is about that one.
    const field = this.querySelector<HTMLInputElement>("#placement");
    if (isTaken && field && field.value.trim() === placement) field.value = "";
    this.offerNumber(subject);
  }

  /** The next number takes the place of the one that was sent. Whoever types something else meanwhile goes on. */
  private offerNumber(sent: string): void {
    const field = this.number();
    const active = document.activeElement;
    const isElsewhere = active !== field && active?.matches("input, select, textarea");
    if (!field || isElsewhere || field.value.trim() !== sent) return;
    field.focus({ preventScroll: true });
    field.select();
  }

  /** Waits for an answer and tells it; nothing else is asked meanwhile. */
  private async during(answer: Promise<api.Answer>, words?: (error: unknown) => string | null): Promise<boolean> {
    this.busy = true;
    this.message = "";
    try {
      const found = await answer;
      this.message = told(found);
      return ["ok", "durable"].includes(found.type);
    } catch (error) {
      const known = error instanceof api.Refused ? error.words() : String(error);
      this.message = words?.(error) ?? known;
      return false;
    } finally {
      this.busy = false;
    }
  }

  /** Takes background pictures of the rig, which somebody said is empty. */
  readonly takePlates = async (): Promise<void> => {
    if (this.busy) return;
    if (await this.during(api.plates())) this.message = t("told_plates");
  };

  private readonly begin = async (event: SubmitEvent) => {
    event.preventDefault();
    const operator = this.value("operator");
    const name = this.value("session-name");
    const about = { operator, project: this.value("project") };
    if (!(await this.during(api.session(name, about)))) return;
    localStorage.setItem(AUTHOR, operator);
    localStorage.setItem(SESSION, name);
    (event.target as HTMLFormElement).reset();
  };

  private readonly close = () => {
    void this.during(api.session(null, {}));
  };

  render(): TemplateResult {
    const now = live.now();
    const isConnected = now !== null && now.daemon !== null;
    const session = now?.daemon?.session ?? null;
    const isBesideSign = shown(now) === "ready_no_plates";
    return html`
      <section class="do" aria-label=${t("press")}>
        <div class="number">
          <div>
            <label for="number">${t("object_number")}</label>
            <input
              id="number"
              autocomplete="off"
              spellcheck="false"
              maxlength="100"
              aria-describedby="number-hint"
              @keydown=${this.entered}
            />
            <p class="quiet" id="number-hint">${t("object_hint")}</p>
          </div>
          <div>
            <label for="placement">${t("placement")}</label>
            <input
              id="placement"
              list="placements"
              autocomplete="off"
              maxlength="100"
              placeholder=${t("placement_example")}
              aria-describedby="placement-hint"
            />
            <datalist id="placements">${PLACEMENTS.map((key) => html`<option value=${t(key)}></option>`)}</datalist>
            <p class="quiet" id="placement-hint">${t("placement_hint")}</p>
          </div>
        </div>
        <button class="press" aria-describedby="press-hint" ?disabled=${this.busy || !isConnected} @click=${this.press}>
          ${this.pressing ? t("pressing") : t("press")}
        </button>
        <p class="quiet" id="press-hint">${t("press_hint")}</p>
        <p class="told" role="status">${this.message}</p>
        ${now?.last ? html`<scand-say .capture=${now.last.capture} .decision=${now.last.decision ?? null}></scand-say>` : nothing}
        <div class="cards">
          ${isBesideSign ? nothing : this.plates(!isConnected || this.busy)}
          <section class="card">
            <h2>${t("session")}</h2>
            ${session ? this.open(session) : this.closed(isConnected)}
          </section>
        </div>
      </section>
    `;
  }

  private plates(disabled: boolean): TemplateResult {
    return html`
      <section class="card">
        <h2>${t("plates")}</h2>
        <scand-plates ?disabled=${disabled} .take=${this.takePlates}></scand-plates>
      </section>
    `;
  }

  private open(session: string): TemplateResult {
    return html`
      <p><bdi>${session}</bdi></p>
      <button ?disabled=${this.busy} @click=${this.close}>${t("session_close")}</button>
    `;
  }

  /** The form for a new session: it is hidden while nobody knows whether one is open, and keeps what was typed into it. */
  private closed(isKnown: boolean): TemplateResult {
    return html`
      ${isKnown ? nothing : html`<p class="quiet">${t("session_unknown")}</p>`}
      <form ?hidden=${!isKnown} @submit=${this.begin}>
        <label for="session-name">${t("session_name")}</label>
        <input
          id="session-name"
          required
          maxlength="48"
          pattern="[A-Za-z0-9_\\-][A-Za-z0-9._\\-]*"
          title=${t("session_name_hint")}
          autocomplete="off"
          spellcheck="false"
        />
        <label for="operator">${t("operator")}</label>
        <input id="operator" maxlength="100" autocomplete="name" .value=${localStorage.getItem(AUTHOR) ?? ""} />
        <label for="project">${t("project")}</label>
        <input id="project" maxlength="100" autocomplete="off" />
        <button ?disabled=${this.busy}>${t("session_begin")}</button>
      </form>
    `;
  }
}

/** A note that somebody made: what it decided or said, who, and when. */
export function noted(note: api.Note): TemplateResult {
  const known: Record<string, string> = {
    accept: t("decision_accepted"),
    reject: t("decision_rejected"),
    clear: t("decision_cleared"),
    text: t("note"),
  };
  const seconds = Number(note.time_ns ?? NaN) / 1e9;
  return html`${known[note.kind] ?? note.kind}${note.text ? html`: <bdi>${note.text}</bdi>` : nothing}
    <span class="quiet">(${note.author ? html`<bdi>${note.author}</bdi>` : t("note_no_name")})
      ${Number.isFinite(seconds) ? date(seconds) : t("note_no_time")}</span>`;
}

/** What was said of a capture, in words, once the daemon has it. */
function heard(kind: string, capture: string, reason: string): string {
  const isBare = reason === "";
  switch (kind) {
    case "accept":
      return isBare ? t("told_accepted", { capture }) : t("told_accepted_why", { capture, reason });
    case "reject":
      return t("told_rejected", { capture, reason });
    case "clear":
      return isBare ? t("told_cleared", { capture }) : t("told_cleared_why", { capture, reason });
    default:
      return t("told_noted", { capture });
  }
}

/** What people say of a capture: accept, reject, take that back, note. */
class SayPart extends Part {
  static properties = {
    capture: {},
    decision: { attribute: false },
    pinned: { state: true },
    author: { state: true },
    message: { state: true },
    busy: { state: true },
  };
  declare capture: string;
  /** What holds of the capture: `accepted` or `rejected`; null if neither is known. */
  declare decision: string | null;
  /** The capture that somebody began to write about; a press meanwhile does not put another one in its place. */
  declare pinned: string;
  /** Who says it, once somebody typed a name. */
  declare author: string | null;
  declare message: string;
  declare busy: boolean;

  constructor() {
    super();
    this.capture = "";
    this.decision = null;
    this.pinned = "";
    this.author = null;
    this.message = "";
    this.busy = false;
  }

  willUpdate(changed: Map<string, unknown>): void {
    if (changed.has("capture") && changed.get("capture") !== undefined) this.message = "";
  }

  private about(): string {
    return this.pinned || this.capture;
  }

  private field(): HTMLInputElement | null {
    return this.querySelector<HTMLInputElement>("#note-text");
  }

  private readonly typed = () => {
    const isEmpty = this.field()?.value === "";
    this.pinned = isEmpty ? "" : this.about();
  };

  private readonly named = (event: Event) => {
    this.author = (event.target as HTMLInputElement).value;
  };

  private async say(kind: string): Promise<void> {
    const capture = this.about();
    const field = this.field();
    const text = field?.value.trim() ?? "";
    // A note without words says nothing, and whoever finds a rejected capture later needs to know why.
    if (["text", "reject"].includes(kind) && text === "") {
      this.message = t(kind === "reject" ? "reject_needs_reason" : "note_needs_words", { capture });
      field?.focus();
      return;
    }
    this.busy = true;
    try {
      const answer = await api.note(capture, kind, text, this.author ?? author());
      if (answer.type === "ok" && field) field.value = "";
      if (answer.type === "ok") this.pinned = "";
      this.message = answer.type === "ok" ? heard(kind, capture, text) : told(answer);
    } catch (error) {
      this.message = error instanceof api.Refused ? error.words() : String(error);
    } finally {
      this.busy = false;
    }
    this.dispatchEvent(new Event("scand-said", { bubbles: true }));
  }

  render(): TemplateResult {
    const isEarlier = this.about() !== this.capture;
    // Of an earlier capture it is not told here.
    const decision = isEarlier ? null : this.decision;
    const back = `clear_${decision ?? ""}`;
    const kinds: [string, string, boolean][] = [
      ["accept", t("accept"), decision === "accepted"],
      ["reject", t("reject"), decision === "rejected"],
      ["clear", t(isKey(back) ? back : "clear"), false],
      ["text", t("note"), false],
    ];
    const now = `say_${decision ?? ""}`;
    return html`
      <fieldset class="say">
        <legend>${t("verdict_of", { capture: this.about() })}</legend>
        ${isEarlier ? html`<p class="warning">${t("say_earlier", { capture: this.about(), last: this.capture })}</p>` : nothing}
        ${isKey(now) ? html`<p data-holds>${t(now)}</p>` : nothing}
        <label for="note-text">${t("note_text")}</label>
        <input id="note-text" maxlength="500" autocomplete="off" ?readonly=${this.busy} @input=${this.typed} />
        <label for="note-author">${t("note_author")}</label>
        <input id="note-author" maxlength="100" autocomplete="name" .value=${this.author ?? author()} @input=${this.named} />
        <p class="row">
          ${kinds.map(
            ([kind, words, isNow]) =>
              html`<button
                type="button"
                data-say=${kind}
                aria-pressed=${isNow ? "true" : nothing}
                ?disabled=${this.busy}
                @click=${() => this.say(kind)}
              >
                ${words}
              </button>`,
          )}
        </p>
        <p class="told" role="status">${this.message}</p>
      </fieldset>
    `;
  }
}

customElements.define("scand-plates", PlatesPart);
customElements.define("scand-do", DoPart);
customElements.define("scand-say", SayPart);
