// The photographs of a capture: small ones beside the model, and a large one of the camera that was chosen.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { Part } from "./element";
import { t } from "./words";
import { spoken } from "./words/said";

interface Shown extends api.Photograph {
  url: string;
}

class PhotographsPart extends Part {
  static properties = {
    recording: {},
    capture: {},
    shown: { state: true },
    error: { state: true },
    large: { state: true },
  };
  declare recording: string;
  declare capture: string;
  /** Null while they are not known. */
  declare shown: Shown[] | null;
  declare error: string;
  /** The camera whose photograph is shown large. */
  declare large: string;
  private name = "";
  /** Ends what was asked for the capture that is shown. */
  private left = new AbortController();

  constructor() {
    super();
    this.shown = null;
    this.error = "";
    this.large = "";
  }

  disconnectedCallback(): void {
    this.forget("");
    super.disconnectedCallback();
  }

  willUpdate(): void {
    const name = `${this.recording}/${this.capture}`;
    if (name === this.name) return;
    this.forget(name);
    void this.load();
  }

  private forget(name: string): void {
    this.name = name;
    this.left.abort();
    this.left = new AbortController();
    for (const { url } of this.shown ?? []) URL.revokeObjectURL(url);
    this.shown = null;
    this.error = "";
    this.large = "";
  }

  private async load(): Promise<void> {
    const { name, recording, capture } = this;
    try {
      const found = await api.photographs(recording, capture, this.left.signal);
      if (name !== this.name) return;
      this.shown = found.map((photograph) => {
        const { picture } = photograph;
        return { ...photograph, url: picture ? URL.createObjectURL(picture) : "" };
      });
    } catch (error) {
      if (name === this.name) this.error = error instanceof api.Refused ? error.words() : String(error);
    }
  }

  updated(): void {
    const dialog = this.querySelector("dialog");
    if (this.large !== "" && dialog && !dialog.open) dialog.showModal();
    if (this.large === "" && dialog?.open) dialog.close();
  }

  private readonly close = () => {
    this.large = "";
  };

  /** This is told after the closing: the dialog may be open again by then. */
  private readonly closed = (event: Event) => {
    if (!(event.target as HTMLDialogElement).open) this.close();
  };

  render(): TemplateResult {
    return html`
      <h2>${t("pictures")}</h2>
      ${this.error ? html`<p role="alert">${this.error}</p>` : nothing}
      ${this.shown === null && !this.error ? html`<p role="status">${t("pictures_loading")}</p>` : nothing}
      ${this.shown?.length === 0 ? html`<p>${t("pictures_none")}</p>` : nothing}
      <ul class="photographs">${this.shown?.map((shown) => html`<li>${this.small(shown)}</li>`)}</ul>
      <dialog aria-label=${t("picture_of", { camera: this.large, capture: this.capture })} @close=${this.closed}>
        ${this.large ? this.enlarged(this.large) : nothing}
      </dialog>
    `;
  }

  private small({ camera, width, height, url, words }: Shown): TemplateResult {
    if (!url) {
      return html`<p class="warning"><bdi>${camera}</bdi>: ${t("picture_unread")} ${spoken(words)}</p>`;
    }
    const enlarge = () => {
      this.large = camera;
    };
    return html`<button data-camera=${camera} aria-label=${t("picture_enlarge", { camera })} @click=${enlarge}>
      <img src=${url} alt="" width=${width} height=${height} />
      <bdi>${camera}</bdi>
    </button>`;
  }

  private enlarged(camera: string): TemplateResult {
    const address = api.photograph(this.recording, this.capture, camera);
    return html`
      <div class="row">
        <button @click=${this.close}>${t("close")}</button>
        <strong><bdi>${camera}</bdi></strong>
      </div>
      <img src=${address} alt=${t("picture_of", { camera, capture: this.capture })} />
    `;
  }
}

customElements.define("scand-photographs", PhotographsPart);
