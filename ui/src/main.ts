// The page: takes the link's token for a session, and shows one of its parts by what is behind `#` in the address.
import { html, LitElement, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import "./capture";
import "./history";
import { live } from "./live";
import "./look";
import "./now";
import { isOn, play, turn } from "./sound";
import "./state";
import "./style.css";
import { choose, type Key, language, others, t } from "./words";

const PARTS: Key[] = ["now", "look", "history", "state"];
const LOOK_MS = 5000;

class Page extends LitElement {
  static properties = { me: { state: true }, route: { state: true }, refusal: { state: true }, isLoading: { state: true } };
  declare me: api.Me | null;
  declare route: string[];
  declare refusal: string;
  declare isLoading: boolean;
  private sign = "";

  constructor() {
    super();
    this.me = null;
    this.route = [];
    this.refusal = "";
    this.isLoading = true;
  }

  protected createRenderRoot(): HTMLElement {
    return this;
  }

  connectedCallback(): void {
    super.connectedCallback();
    addEventListener("hashchange", () => this.go());
    live.addEventListener("change", () => this.heard());
    setInterval(() => void this.look(), LOOK_MS);
    void this.begin();
  }

  /** A link's token is used once, and taken out of the address before anything else happens. */
  private async begin(): Promise<void> {
    const token = /^#pair=([0-9a-f]{64})$/.exec(location.hash)?.[1];
    if (token) {
      history.replaceState(null, "", "/#/now");
      try {
        await api.pair(token);
      } catch (error) {
        this.refusal = error instanceof api.Refused ? error.reason : String(error);
      }
    }
    this.go();
    await this.enter();
    this.isLoading = false;
  }

  private async enter(): Promise<void> {
    try {
      this.me = await api.me();
      live.start();
    } catch (error) {
      if (error instanceof api.Refused && error.status === 401) this.me = null;
    }
  }

  /** Without the stream: either the connection is gone, or the session. */
  private async look(): Promise<void> {
    if (live.now() !== null && this.me) return;
    try {
      const me = await api.me();
      if (!this.me) {
        this.me = me;
        live.start();
      }
    } catch (error) {
      if (error instanceof api.Refused && error.status === 401) this.me = null;
    }
  }

  private heard(): void {
    const sign = live.now()?.sign ?? "unknown";
    if (sign !== this.sign) {
      this.sign = sign;
      play(sign);
      document.title = `${t(`sign_${sign}` as Key)} – scand`;
    }
  }

  private go(): void {
    const parts = location.hash.replace(/^#\/?/, "").split("/");
    this.route = parts.map((part) => decodeURIComponent(part));
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
    if (!this.me) return this.isLoading ? nothing : this.login();
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

  private login(): TemplateResult {
    return html`
      <h1>${t("login")}</h1>
      ${this.refusal ? html`<p role="alert">${t("login_failed", { reason: this.refusal })}</p>` : nothing}
      <p>${t("login_hint")}</p>
      <pre>scand page pair</pre>
      <p>${t("login_then")}</p>
    `;
  }
}

customElements.define("scand-page", Page);
