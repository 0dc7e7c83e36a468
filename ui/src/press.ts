// A press: its id is made before it is sent, so that however often it is sent, it is one press. It is sent again for ten
// seconds while the connection is broken; after that the person decides, for hands may be in the picture again. With it
// goes when it was, so that the page's process takes none that was on its way for longer.
import { type Answer, Refused, sendPress } from "./api";
import { live } from "./live";

const STORED = "scand-press";
const AGAIN_MS = 10_000;
const PAUSE_MS = 500;

interface Pending {
  id: string;
  subject: string;
  placement: string;
  at: number;
  /** When somebody pressed, by the clock of the page's process; null if that is not known. */
  pressed_ms: number | null;
}

/** A press that is under way: what was sent, and the answer. */
export interface Pressed {
  subject: string;
  placement: string;
  answer: Promise<Answer>;
}

let running: Pressed | null = null;

function newId(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return "page-" + Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Presses; while one press is under way, a further tap is the same press. */
export function press(subject: string, placement: string): Pressed {
  const pending = { id: newId(), subject, placement, at: Date.now(), pressed_ms: live.clock() };
  return running ?? begin(pending, false);
}

/** The press that a reload of the page cut short, if that was a moment ago. */
export function resume(): Pressed | null {
  const stored = sessionStorage.getItem(STORED);
  if (stored === null || running) return running;
  try {
    const pending = JSON.parse(stored) as Pending;
    const passed = Date.now() - pending.at;
    if (passed >= 0 && passed < AGAIN_MS) return begin(pending, true);
  } catch {
    // Not one of ours.
  }
  sessionStorage.removeItem(STORED);
  return null;
}

function begin(pending: Pending, isAgain: boolean): Pressed {
  sessionStorage.setItem(STORED, JSON.stringify(pending));
  const answer = send(pending, isAgain).finally(() => {
    running = null;
    sessionStorage.removeItem(STORED);
  });
  running = { subject: pending.subject, placement: pending.placement, answer };
  return running;
}

/** Sends a press; `isAgain` if it was sent before. */
async function send({ id, subject, placement, pressed_ms }: Pending, isAgain: boolean): Promise<Answer> {
  const begun = performance.now();
  for (;;) {
    try {
      return await sendPress(id, subject, placement, pressed_ms);
    } catch (error) {
      const isOver = performance.now() - begun > AGAIN_MS;
      if (!(error instanceof Refused) || error.code !== "network" || isOver) throw isAgain ? unsure(error) : error;
    }
    isAgain = true;
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
  }
}

/** Why a press that was sent before failed: if it is late now, it may have been taken all the same. */
function unsure(error: unknown): unknown {
  if (!(error instanceof Refused) || error.code !== "late") return error;
  return new Refused("network", error.reason, error.status);
}
