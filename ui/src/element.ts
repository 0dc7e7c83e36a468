// What the parts of the page have in common: they draw into the document itself, where the one style sheet holds.
import { LitElement } from "lit";
import { live } from "./live";

export class Part extends LitElement {
  protected createRenderRoot(): HTMLElement {
    return this;
  }

  private readonly again = () => this.requestUpdate();

  connectedCallback(): void {
    super.connectedCallback();
    live.addEventListener("change", this.again);
    addEventListener("scand-language", this.again);
  }

  disconnectedCallback(): void {
    live.removeEventListener("change", this.again);
    removeEventListener("scand-language", this.again);
    super.disconnectedCallback();
  }
}
