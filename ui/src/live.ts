// What holds now, as the process tells it in a stream. What is shown counts as known only while the stream is alive: after
// ten seconds without a word, by the monotonic or by the wall clock (a tablet that slept), nothing is known any more. The
// event `change` tells that something else may hold, `lost` that the stream broke off, `back` that something is known
// again after a time when nothing was.
import type { Now } from "./api";
import { type Moment, moment, since } from "./clock";

const STALE_MS = 10_000;
const AGAIN_MS = 5_000;

interface Heard {
  now: Now;
  at: Moment;
}

export class Live extends EventTarget {
  private heard: Heard | null = null;
  private source: EventSource | null = null;
  private opened = 0;
  private hasHeard = false;

  /** Listens; again with a stream of its own for who signs in later. */
  start(): void {
    const isFirst = this.source === null;
    this.open();
    if (!isFirst) return;
    setInterval(() => this.look(), 1000);
    for (const event of ["online", "pageshow", "focus"]) addEventListener(event, () => this.look());
    document.addEventListener("visibilitychange", () => this.look());
  }

  /** What holds now, or null if that is not known. */
  now(): Now | null {
    return this.passed() < STALE_MS ? (this.heard?.now ?? null) : null;
  }

  /** The time by the clock of the process, in milliseconds, or null if that is not known. */
  clock(): number | null {
    const told = this.now()?.clock_ms;
    if (!this.heard || told === undefined) return null;
    return Math.round(told + performance.now() - this.heard.at.monotonic);
  }

  /** Milliseconds since the last word of the process. */
  passed(): number {
    return this.heard ? since(this.heard.at) : Infinity;
  }

  private open(): void {
    this.source?.close();
    this.opened = performance.now();
    const source = new EventSource("/api/events");
    this.source = source;
    source.addEventListener("now", (event) => {
      const now = JSON.parse((event as MessageEvent<string>).data) as Now;
      const isBack = this.hasHeard && this.now() === null;
      this.hasHeard = true;
      this.heard = { now, at: moment() };
      this.changed();
      if (isBack) this.dispatchEvent(new Event("back"));
    });
    source.addEventListener("error", () => {
      // The connection is gone: what was heard is not known to hold.
      this.heard = null;
      this.changed();
      this.dispatchEvent(new Event("lost"));
    });
  }

  private look(): void {
    const isSilent = this.passed() >= STALE_MS;
    if (isSilent && performance.now() - this.opened > (this.heard ? 0 : AGAIN_MS)) {
      this.heard = null;
      this.open();
    }
    this.changed();
  }

  private changed(): void {
    this.dispatchEvent(new Event("change"));
  }
}

export const live = new Live();
