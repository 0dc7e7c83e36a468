// The viewer of a published folder (`scand publish`). The page has a picture and names the files of the levels of
// detail, the least detailed first; this script puts the model in the picture's place. A page whose model cannot be
// shown keeps its picture.
import { PROVENANCES } from "./provenance";
import type { Measured, Mode, Shade } from "./viewer";
import { Viewer } from "./viewer";
import { en } from "./words/en";

const MODES: Mode[] = ["textured", "shaded", "provenance", "error"];
const FROM = PROVENANCES.map((name) => en[`from_${name}`]);
const SVG = "http://www.w3.org/2000/svg";

function element<K extends keyof HTMLElementTagNameMap>(name: K, text = "", about: Record<string, string> = {}): HTMLElementTagNameMap[K] {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(about)) made.setAttribute(key, value);
  return made;
}

class Shown {
  private readonly canvas = element("canvas", "", { tabindex: "0", role: "application", "aria-label": en.viewer_label });
  private readonly status = element("p", "", { role: "status" });
  private readonly buttons = element("div", "", { class: "buttons", role: "group", "aria-label": en.view_as });
  private readonly measure = element("button", en.measure, { "data-measure": "", "aria-pressed": "false" });
  private readonly hint = element("p", en.viewer_hint);
  private readonly legend = element("ul", "", { class: "legend" });
  private viewer: Viewer | null = null;
  private mode: Mode = "textured";
  /** Ends when all levels that were asked for so far were loaded, or failed. */
  private loads: Promise<unknown> = Promise.resolve();

  constructor(
    private readonly section: Element,
    private readonly picture: Element,
    private readonly levels: { address: string; words: string }[],
  ) {}

  async start(): Promise<void> {
    // Two levels load by themselves: one at once, one that looks good. The others wait for a button.
    const [first, ...further] = this.levels;
    if (!first) return;
    this.picture.replaceWith(this.canvas);
    this.section.append(this.buttons, this.status, this.hint, this.legend);
    try {
      this.viewer = await Viewer.open(this.canvas, first.address, (told) => this.measured(told));
    } catch (error) {
      this.canvas.replaceWith(this.picture);
      this.buttons.remove();
      this.hint.remove();
      this.legend.remove();
      this.status.textContent = en.viewer_failed.replace("{reason}", String(error));
      return;
    }
    this.offer(further);
    this.choose("textured");
    this.loaded(first.address);
    const better = further.at(-2);
    if (better) await this.load(better.address);
  }

  private offer(further: { address: string; words: string }[]): void {
    for (const mode of MODES) {
      const button = element("button", en[`view_${mode}`], { "data-mode": mode });
      button.addEventListener("click", () => this.choose(mode));
      this.buttons.append(button);
    }
    this.measure.addEventListener("click", () => {
      const isMeasuring = this.measure.getAttribute("aria-pressed") !== "true";
      this.viewer?.measure(isMeasuring);
      this.measure.setAttribute("aria-pressed", String(isMeasuring));
      this.status.textContent = isMeasuring ? en.measure_first : "";
    });
    this.buttons.append(this.measure);
    this.move("+", en.view_in, (viewer) => viewer.zoomIn());
    this.move("−", en.view_out, (viewer) => viewer.zoomOut());
    this.move(en.view_reset, en.view_reset, (viewer) => viewer.reset());
    const all = further.at(-1);
    if (!all) return;
    const button = element("button", en.view_full.replace("{size}", all.words), { "data-full": "" });
    button.addEventListener("click", async () => {
      button.disabled = true;
      button.disabled = await this.load(all.address);
    });
    this.buttons.append(button);
  }

  /** A button that moves the eye. */
  private move(text: string, label: string, moved: (viewer: Viewer) => void): void {
    const button = element("button", text, { "aria-label": label });
    button.addEventListener("click", () => this.viewer && moved(this.viewer));
    this.buttons.append(button);
  }

  /** Loads a level after those that were asked for before, so that the last one stays; whether it is shown now. */
  private load(address: string): Promise<boolean> {
    const load = this.loads.then(() => this.replace(address));
    this.loads = load;
    return load;
  }

  private async replace(address: string): Promise<boolean> {
    this.status.textContent = en.viewer_loading;
    try {
      await this.viewer?.load(address);
      this.choose(this.mode);
      this.loaded(address);
      return true;
    } catch (error) {
      this.status.textContent = en.viewer_failed.replace("{reason}", String(error));
      return false;
    }
  }

  private loaded(address: string): void {
    this.status.textContent = "";
    // For whoever waits until the model is there.
    this.canvas.dataset.loaded = address;
  }

  private measured(told: Measured): void {
    const isDone = typeof told === "number";
    this.status.textContent = isDone ? en.measure_result.replace("{mm}", told.toFixed(1)) : en[`measure_${told}`];
    this.measure.setAttribute("aria-pressed", String(!isDone));
  }

  private choose(mode: Mode): void {
    this.mode = mode;
    this.viewer?.show(mode);
    for (const button of this.buttons.querySelectorAll("[data-mode]")) {
      button.setAttribute("aria-pressed", String(button.getAttribute("data-mode") === mode));
    }
    const entries = (this.viewer?.scale(mode) ?? []).map((shade) => {
      const swatch = document.createElementNS(SVG, "svg");
      swatch.setAttribute("viewBox", "0 0 10 10");
      swatch.setAttribute("aria-hidden", "true");
      const rect = document.createElementNS(SVG, "rect");
      for (const [key, text] of [["width", "10"], ["height", "10"], ["fill", shade.color]]) rect.setAttribute(key, text);
      swatch.append(rect);
      const item = element("li");
      item.append(swatch, ` ${shadeWords(shade, mode)}`);
      return item;
    });
    this.legend.replaceChildren(...entries);
  }
}

/** What a colour means. */
function shadeWords({ value, isOpen }: Shade, mode: Mode): string {
  if (mode !== "error") return FROM[value] ?? String(value);
  const mm = `${value.toFixed(2)} mm`;
  return isOpen ? en.error_and_more.replace("{mm}", mm) : mm;
}

for (const section of document.querySelectorAll(".viewer")) {
  const picture = section.querySelector(".picture");
  const named = [...section.querySelectorAll("[data-level]")];
  const levels = named.map((level) => ({ address: level.getAttribute("data-level") ?? "", words: level.textContent ?? "" }));
  if (picture) void new Shown(section, picture, levels).start();
}
