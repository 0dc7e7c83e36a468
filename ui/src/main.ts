// The page: signs in by the link's token, and shows one of its parts by what is behind `#` in the address.
import { html, LitElement, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import "./capture";
import "./history";
import { live } from "./live";
import "./look";
import "./now";
import { shown } from "./signs";
import { isOn, play, turn, wake } from "./sound";
import "./state";
import "./style.css";
import { choose, type Key, language, others, t } from "./words";
import { said } from "./words/said";

const PARTS: Key[] = ["now", "look", "history", "state"];
const LOOK_MS = 5000;

class Page extends LitElement {
  static properties = {
    me: { state: true },
    route: { state: true },
    refusal: { state: true },
    isLoading: { state: true },
    isAway: { state: true },
    isOver: { state: true },
  };
  declare me: api.Me | null;
  declare route: string[];
  declare refusal: string;
  declare isLoading: boolean;
  /** Whether it is not known if this device is signed in, because the page's process does not answer. */
  declare isAway: boolean;
  /** Whether this device was signed in, and is no more. */
  declare isOver: boolean;
  private sign = "";
  /** Whether the process that serves this page is of another version by now, whose files this page does not have. */
  private isOutdated = false;
  /** How often it was asked who is signed in, and the first of these answers that still counts. */
  private asked = 0;
  private counting = 0;
  /** What a tone was last due for; null before anything was heard. */
  private told: string | null = null;

  constructor() {
    super();
    this.me = null;
    this.route = [];
    this.refusal = "";
    this.isLoading = true;
    this.isAway = false;
    this.isOver = false;
  }

  protected createRenderRoot(): HTMLElement {
    return this;
  }

  connectedCallback(): void {
    super.connectedCallback();
    addEventListener("hashchange", () => void this.arrive());
    live.addEventListener("change", () => this.heard());
    // Either the connection is gone, or this device is signed out.
    live.addEventListener("lost", () => void this.enter());
    // The process may have been started again since, in another version.
    live.addEventListener("back", () => void this.enter());
    for (const event of ["pointerdown", "keydown"]) addEventListener(event, wake);
    setInterval(() => void this.look(), LOOK_MS);
    void this.begin();
  }

  private async begin(): Promise<void> {
    await this.arrive();
    // A link's token signed this device in already, or did not.
    if (this.isLoading) await this.enter();
    this.isLoading = false;
  }

  /** Goes where the address says; a link may also be opened where the page is open already. */
  private async arrive(): Promise<void> {
    // What was typed into the part that is left now is lost anyway.
    if (this.isOutdated) return location.reload();
    const token = /^#pair=([0-9a-f]{64})$/.exec(location.hash)?.[1];
    if (token) await this.take(token);
    this.go();
  }

  /** A link's token is used once, and taken out of the address before anything else happens. */
  private async take(token: string): Promise<void> {
    history.replaceState(null, "", "/#/now");
    this.refusal = "";
    try {
      await api.pair(token);
      this.counting = this.asked + 1;
      // What the page shows from then on belongs to the one who signed in now, who may have another role.
      this.me = null;
      this.isLoading = true;
    } catch (error) {
      this.refusal = error instanceof api.Refused ? error.reason : String(error);
    }
    await this.enter();
    this.isLoading = false;
  }

  /** Answers come in any order: one asked for before the last that told, or before a sign-in, says nothing new. */
  private async enter(): Promise<void> {
    const turn = ++this.asked;
    try {
      const me = await api.me();
      if (turn < this.counting) return;
      this.counting = turn;
      api.speakFor(me);
      this.isAway = false;
      this.isOver = false;
      if (!this.me) {
        this.me = me;
        live.start();
      } else if (this.me.version !== me.version) {
        this.me = me;
        this.isOutdated = true;
      }
    } catch (error) {
      if (turn < this.counting) return;
      const isWithout = error instanceof api.Refused && error.status === 401;
      if (isWithout) {
        this.counting = turn;
        this.isOver ||= this.me !== null;
        this.me = null;
      }
      this.isAway = !isWithout;
    }
  }

  /** Without the stream: either the connection is gone, or this device is signed out. */
  private async look(): Promise<void> {
    if (live.now() === null || !this.me) await this.enter();
  }

  private heard(): void {
    const now = live.now();
    const sign = now?.sign ?? "unknown";
    this.sound(sign, `${now?.capture ?? ""} ${now?.news ?? ""}`);
    const look = shown(now);
    if (look === this.sign) return;
    this.sign = look;
    this.entitle();
  }

  private entitle(): void {
    if (this.sign !== "") document.title = `${t(`sign_${this.sign}` as Key)} – scand`;
  }

  /** A tone for each news, once: neither a connection that comes back nor a page that was just opened is news. */
  private sound(sign: string, about: string): void {
    if (["unknown", "away"].includes(sign)) return;
    const due = `${sign} ${about}`;
    if (this.told !== null && this.told !== due) play(sign);
    this.told = due;
  }

  private go(): void {
    const parts = location.hash.replace(/^#\/?/, "").split("/");
    this.route = parts.map(decoded);
  }

  protected updated(): void {
    document.documentElement.lang = language();
  }

  render(): TemplateResult {
    return html`
      <a class="skip" href="#content" @click=${this.skip}>${t("skip")}</a>
      <header>
        ${this.me ? this.navigation() : html`<span class="name">scand</span>`}
        <div class="row">
          ${others().map(
            ([tag, name]) => html`<button lang=${tag} @click=${() => this.speak(tag)}>${name}</button>`,
          )}
          ${this.me ? this.tools() : nothing}
        </div>
      </header>
      <main id="content" tabindex="-1">${this.content()}</main>
      <footer><a href="/licences.txt">${t("licences")}</a></footer>
    `;
  }

  private readonly skip = (event: Event) => {
    event.preventDefault();
    this.querySelector<HTMLElement>("#content")?.focus();
  };

  private speak(tag: string): void {
    choose(tag);
    this.entitle();
    this.requestUpdate();
    dispatchEvent(new Event("scand-language"));
  }

  private navigation(): TemplateResult {
    const current = PARTS.includes(this.route[0] as Key) ? this.route[0] : "now";
    return html`<nav aria-label="scand">
      ${PARTS.map(
        (part) =>
          html`<a href="#/${part}" aria-current=${part === current ? "page" : nothing}>${t(part)}</a>`,
      )}
    </nav>`;
  }

  private tools(): TemplateResult {
    const sound = () => {
      turn(!isOn());
      this.requestUpdate();
    };
    const leave = async () => {
      await api.leave().catch(() => null);
      location.reload();
    };
    return html`
      <button aria-pressed=${isOn()} @click=${sound}>${t("sound")}</button>
      <button @click=${leave}>${t("leave")}</button>
    `;
  }

  private content(): TemplateResult | typeof nothing {
    if (!this.me && this.isLoading) return nothing;
    if (!this.me) return this.isAway ? this.away() : this.login();
    const operator = this.me.role === "operator";
    const [part, recording, capture] = this.route;
    if (part === "history" && recording && capture) {
      return html`<scand-capture .recording=${recording} .capture=${capture} ?operator=${operator}></scand-capture>`;
    }
    if (part === "history") return html`<scand-history .recording=${recording ?? ""}></scand-history>`;
    if (part === "look") return html`<scand-look></scand-look>`;
    if (part === "state") return html`<scand-state .me=${this.me}></scand-state>`;
    return html`<scand-now ?operator=${operator}></scand-now>`;
  }

  /** Whether this device is signed in is not known: the page asks again by itself. */
  private away(): TemplateResult {
    return html`
      <h1>${t("sign_unknown")}</h1>
      ${this.refused()}
      <p role="status">${t("sign_unknown_hint")}</p>
    `;
  }

  private refused(): TemplateResult | typeof nothing {
    return this.refusal ? html`<p role="alert">${t("login_failed", { reason: said(this.refusal) })}</p>` : nothing;
  }

  private login(): TemplateResult {
    return html`
      <h1>${t("login")}</h1>
      ${this.isOver ? html`<p role="alert">${t("login_over")}</p>` : nothing}
      ${this.refused()}
      <p>${t("login_hint")}</p>
      <pre>scand page pair</pre>
      <p>${t("login_then")}</p>
    `;
  }
}

/** A part of an address; as it stands, if it is not what an address may have. */
function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

customElements.define("scand-page", Page);
