// "State": cameras with their settings as read back, disk, models, background pictures, and what to do for what is wrong.
import { html, nothing, type TemplateResult } from "lit";
import * as api from "./api";
import { type Moment, moment, since } from "./clock";
import { platesLimit } from "./configured";
import { Part } from "./element";
import { backlog, platesAge } from "./now";
import { age, counted, type Key, t } from "./words";
import { named, said, spoken } from "./words/said";

const EVERY_MS = 3000;
const OLD_PLATES_H = 12;
const OLD_CALIBRATION_H = 90 * 24;
const FEW_CAPTURES = 20;
/** How what is said of a camera's network clock begins. */
const CLOCK = "PTP: ";
/** What tells how a camera is and leaves nothing to be done. */
const IN_ORDER = [/^PTP: (Master|Slave)(, -?\d+ ns from its master)?$/, /^a raw reading counts /, /^a file of OpenNI's: /];

interface Camera {
  kind?: string;
  state: string;
  words: string;
  settings?: [string, string, string][];
  health?: [string, string][];
  remarks?: string[];
  lost_frames?: number;
}

interface Status {
  cameras?: Record<string, Camera>;
  capture_bytes?: number;
  captures_left?: number;
  plates_age_h?: number | null;
  calibration_age_h?: number | null;
  version?: string;
  models?: api.Backlog | null;
  session?: string | null;
}

class StatePart extends Part {
  static properties = { me: { attribute: false }, status: { state: true }, heard: { state: true }, error: { state: true } };
  declare me: api.Me;
  declare status: Status | null;
  /** When the status arrived; and how old it was then, in milliseconds. */
  declare heard: Moment;
  declare error: string;
  private age_ms = 0;
  private timer = 0;

  constructor() {
    super();
    this.status = null;
    this.heard = moment();
    this.error = "";
  }

  connectedCallback(): void {
    super.connectedCallback();
    void this.load();
    this.timer = window.setInterval(() => void this.load(), EVERY_MS);
  }

  disconnectedCallback(): void {
    clearInterval(this.timer);
    super.disconnectedCallback();
  }

  private async load(): Promise<void> {
    try {
      const found = await api.state();
      this.status = found.status as Status | null;
      this.heard = moment();
      this.age_ms = found.age_ms ?? 0;
      this.error = this.status ? "" : t("error_away");
    } catch (error) {
      this.status = null;
      this.error = error instanceof api.Refused ? error.words() : String(error);
    }
  }

  render(): TemplateResult {
    return html`
      <h1>${t("state")}</h1>
      ${this.error ? html`<p role="alert">${this.error}</p>` : nothing}
      ${this.status ? this.all(this.status) : nothing}
      <p class="quiet">${this.me.rig ? `${t("rig")}: ${this.me.rig}. ` : ""}${t("version")}: ${this.me.version}.
        ${this.status?.version ? `${t("daemon_version")}: ${this.status.version}.` : ""}</p>
    `;
  }

  private all(status: Status): TemplateResult {
    const todo = this.todo(status);
    const plates = status.plates_age_h ?? null;
    const left = room(status);
    return html`
      <section class="card">
        <h2>${t("todo")}</h2>
        ${todo.length === 0 ? html`<p>${t("todo_nothing")}</p>` : html`<ul>${todo.map((text) => html`<li>${text}</li>`)}</ul>`}
      </section>
      <div class="cards">
        <section class="card"><h2>${t("disk")}</h2><p>${left === null ? t("disk_unknown") : counted("captures_left", left)}</p></section>
        <section class="card"><h2>${t("models")}</h2><p>${status.models ? backlog(status.models) : t("models_off")}</p></section>
        <section class="card">
          <h2>${t("plates")}</h2>
          <p>${plates === null ? t("plates_none") : platesAge(plates, status.models ?? null)}</p>
        </section>
        <section class="card"><h2>${t("calibration")}</h2><p>${calibration(status)}</p></section>
      </div>
      <h2>${t("cameras")}</h2>
      <ul class="cameras">
        ${Object.entries(status.cameras ?? {}).map(([id, camera]) => this.camera(id, camera))}
      </ul>
      <p class="quiet">${t("updated", { age: age(since(this.heard) + this.age_ms) })}</p>
    `;
  }

  private todo(status: Status): (string | TemplateResult)[] {
    const found: (string | TemplateResult)[] = [];
    for (const [camera, about] of Object.entries(status.cameras ?? {})) {
      if (about.state !== "ready") {
        const isOpening = about.state === "opening";
        found.push(isOpening ? t("todo_opening", { camera }) : t("todo_camera", { camera, words: said(about.words || about.state) }));
        continue;
      }
      if (about.lost_frames) found.push(t("todo_lost", { camera, n: about.lost_frames }));
      found.push(...advice(about).map((words) => html`${camera}: ${words}`));
    }
    const plates = status.plates_age_h ?? null;
    if (plates === null) found.push(t("todo_plates_none"));
    else if (plates > (platesLimit(status.models ?? null) ?? Infinity)) {
      found.push(t("todo_plates_over", { age: age(plates * 3_600_000) }));
    } else if (plates > OLD_PLATES_H) found.push(t("todo_plates_old", { age: age(plates * 3_600_000) }));
    const calibrated = status.calibration_age_h;
    if (calibrated === null) found.push(t("todo_calibration_none"));
    else if ((calibrated ?? 0) > OLD_CALIBRATION_H) found.push(t("todo_calibration_old", { age: hours(calibrated) }));
    const { version } = status;
    if (version && version !== this.me.version) {
      found.push(t("todo_versions", { daemon: version, page: this.me.version }));
    }
    const left = room(status);
    if (left !== null && left < FEW_CAPTURES) found.push(counted("todo_disk", left));
    return found;
  }

  private camera(id: string, camera: Camera): TemplateResult {
    const known = ["ready", "away", "opening"].includes(camera.state);
    const health = (camera.health ?? []).map(measured);
    const lost = camera.lost_frames ? [t("lost_frames", { n: camera.lost_frames })] : [];
    return html`
      <li class="card">
        <h3><bdi>${id}</bdi>: ${known ? t(`camera_${camera.state}` as Key) : camera.state}</h3>
        <p>${spoken(camera.words)}</p>
        ${health.length + lost.length > 0 ? html`<p>${[...health, ...lost].join(" · ")}</p>` : nothing}
        ${lasting(camera).map((remark) => html`<p>${spoken(remark)}</p>`)}
        ${camera.settings?.length
          ? html`<details>
              <summary>${t("camera_settings")}</summary>
              <dl>
                ${camera.settings.map(
                  ([name, asked, read]) => html`<div>
                    <dt>${named(name)}</dt>
                    <dd>${named(read)}${asked === read ? "" : ` (${t("asked_for", { value: named(asked) })})`}</dd>
                  </div>`,
                )}
              </dl>
            </details>`
          : nothing}
      </li>
    `;
  }
}

/** What a camera reports of its network clock now: one text, or none. */
function clocks({ health }: Camera): string[] {
  return (health ?? []).filter(([name]) => name === "PTP").map(([, value]) => `${CLOCK}${value}`);
}

/** A camera's remarks; where it reports its network clock, without what a remark tells of that: how it was when the
 * camera was opened. */
function lasting(camera: Camera): string[] {
  const isClockTold = clocks(camera).length > 0;
  return (camera.remarks ?? []).filter((remark) => !isClockTold || !remark.startsWith(CLOCK));
}

/** What is to be done about a camera that works: as `scand check` judges its remarks and its network clock. */
function advice(camera: Camera): TemplateResult[] {
  const open = [...clocks(camera), ...lasting(camera)].filter((words) => !IN_ORDER.some((form) => form.test(words)));
  return open.map((words) => (words.startsWith(CLOCK) ? html`${spoken(words)}. ${t("todo_ptp")}` : spoken(words)));
}

/** What a camera reports of itself. */
function measured([name, value]: [string, string]): string {
  return name === "PTP" ? said(`${CLOCK}${value}`) : `${named(name)} ${value}`;
}

/** How many captures fit on the disk; null while no camera has told its settings, for then a capture has no size. */
function room(status: Status): number | null {
  return status.capture_bytes ? (status.captures_left ?? 0) : null;
}

function hours(found: number | null | undefined): string {
  return age((found ?? 0) * 3_600_000);
}

/** How old the calibration is; a daemon of an earlier version does not tell. */
function calibration(status: Status): string {
  const found = status.calibration_age_h;
  if (found === undefined) return t("calibration_unknown");
  return found === null ? t("calibration_none") : t("calibration_age", { age: hours(found) });
}

customElements.define("scand-state", StatePart);
