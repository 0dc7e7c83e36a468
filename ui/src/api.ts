// The page's requests to the process that serves it: who am I, what holds now, what was scanned, and what people do.
import { t } from "./words";
import { said } from "./words/said";

export interface Me {
  role: "viewer" | "operator";
  token: string;
  rig: string;
  version: string;
}

export interface Last {
  capture: string;
  recording: string | null;
  subject: string | null;
  sign: string;
  reasons: string[];
  decision?: string | null;
  /** False if others may have been taken since, of which the page did not hear. */
  is_last?: boolean;
  age_ms: number;
}

export interface Backlog {
  waiting: number;
  running: { capture: string; seconds: number }[];
  expected_s: number | null;
  /** Models that are to be made again with other settings; without it of an older daemon. */
  remakes?: number;
  /** What models are made with from now on, by the settings' names; without it of an older daemon. */
  settings?: Record<string, unknown>;
}

export interface Now {
  sign: string;
  capture: string;
  /** The recording that has the capture, as far as it is known. */
  recording: string | null;
  reasons: string[];
  age_ms: number | null;
  /** Tells the sign from other news that say the same; null while nothing happens. */
  news?: number | null;
  last: Last | null;
  daemon: {
    age_ms: number;
    session: string | null;
    captures_left: number | null;
    models: Backlog | null;
    plates_age_h: number | null;
  } | null;
  object: ObjectTold | null;
  /** The newest first, one of a capture. */
  remade: Remade[];
  history: number;
  /** Milliseconds since the page's process began. */
  clock_ms?: number;
}

/** What the daemon told of an object of which there are several captures. */
export interface ObjectTold {
  subject: string;
  registered: {
    capture: string;
    level: Level;
    /** By what its pose was found; null without a pose. */
    held_by: string | null;
    words: string;
    left_out: string[];
    unseen_percent: number;
    show_next: string | null;
    age_ms: number;
    /** Whether a capture of the object was taken, accepted or rejected since. */
    is_old: boolean;
    changed: Changed | null;
  } | null;
  fused: {
    capture: string;
    level: Level | null;
    reasons: string[];
    left_out: string[];
    folder: [string, string] | null;
    age_ms: number;
    is_old: boolean;
    changed: Changed | null;
  } | null;
}

/** What became of a capture last: `taken`, `accepted`, `rejected`, or `cleared` if a decision was taken back. */
export interface Changed {
  capture: string;
  what: string;
}

/** What became of the last model of a capture that was to be made again. */
export interface Remade {
  capture: string;
  level: Level | null;
  reasons: string[];
  folder: [string, string] | null;
  age_ms: number;
}

export type Level = "green" | "amber" | "red";

export interface Reason {
  level: string;
  code: string;
  words: string;
}

/** What somebody said of a capture: `accept`, `reject`, `clear` or `text`, and when in nanoseconds since 1970. */
export interface Note {
  kind: string;
  text: string;
  author: string | null;
  time_ns: string | null;
}

export interface Summary {
  capture: string;
  recording: string;
  verdict: "green" | "amber" | "red" | "failed" | "unread";
  reasons: Reason[];
  subject: string | null;
  placement: string | null;
  time_s: number | null;
  decision: string | null;
  notes: Note[];
  has_preview: boolean;
  has_model: boolean;
  /** Differs between one state of the model's file and another. */
  model_tag: string | null;
}

/** Recordings, the newest first; `all` is how many there are, listed or not. `seen` has captures without a report. */
export interface Recordings {
  recordings: { name: string; changed_s: number }[];
  all: number;
  seen: Last[];
}

/** The captures of a recording, the newest first; `all` is how many there are, listed or not. */
export interface Captures {
  captures: Summary[];
  all: number;
}

/** A closed polygon in pixels of a look's picture. */
export type Polygon = [number, number][];

/** What is seen in a picture of a camera. */
export interface Seen {
  width: number;
  height: number;
  scale: number;
  /** Whether the camera joined pixels; then `clipped_ppm` and `sharpness_percent` are of the whole picture before it. */
  is_binned?: boolean;
  measured_before_ms?: number;
  why_whole?: string;
  clipped_ppm?: number;
  clipped?: Polygon[];
  sharpness_percent?: number;
  outline?: Polygon[];
  touches?: string[];
  no_outline?: string;
  readings_percent?: number;
}

/** What a camera showed last; without a picture, why there is none. */
export interface CameraLook {
  age_ms: number;
  picture: string | null;
  seen: Seen | null;
  words: string | null;
}

export interface Look {
  number: number;
  problem: string | null;
  cameras: Record<string, CameraLook>;
  /** How sharp each camera's picture was in the last capture with a green model. */
  good: Record<string, number>;
}

export interface Answer {
  type: string;
  capture?: string;
  reason?: string;
  words?: string;
}

/** A refusal by the process, with its code; `network` if it did not answer. */
export class Refused extends Error {
  constructor(
    readonly code: string,
    readonly reason: string,
    readonly status: number,
  ) {
    super(reason);
  }

  /** In the language of the page, as far as the code is known. */
  words(): string {
    if (this.code === "away") return t("error_away");
    if (this.code === "unsure") return t("error_unsure");
    if (this.code === "full") return t("error_full");
    if (this.code === "late") return t("error_late");
    if (this.code === "unmade") return t("error_unmade");
    if (this.code === "viewer") return t("error_viewer");
    if (this.code === "network") return t("error_network");
    return t("error_other", { reason: said(this.reason) });
  }
}

let token = "";

async function call(path: string, init: RequestInit, patience_ms: number): Promise<unknown> {
  let response: Response;
  try {
    response = await fetch(path, { ...init, signal: AbortSignal.timeout(patience_ms), cache: "no-store" });
  } catch (error) {
    throw new Refused("network", String(error), 0);
  }
  let body: unknown;
  try {
    body = await response.json();
  } catch (error) {
    throw new Refused("network", String(error), 0);
  }
  if (!response.ok) {
    const { code, words } = body as { code?: string; words?: string };
    throw new Refused(code ?? "other", words ?? String(response.status), response.status);
  }
  return body;
}

function get(path: string): Promise<unknown> {
  return call(path, {}, 10_000);
}

function post(path: string, body: object, patience_ms = 70_000): Promise<unknown> {
  const headers = { "Content-Type": "application/json", "X-Scand-Token": token };
  return call(path, { method: "POST", headers, body: JSON.stringify(body) }, patience_ms);
}

/** Who is signed in on this device; refused if nobody is. */
export async function me(): Promise<Me> {
  return (await get("/api/me")) as Me;
}

/** From now on, what is asked for is asked in this session. */
export function speakFor(session: Me): void {
  token = session.token;
}

export async function pair(secret: string): Promise<void> {
  await post("/api/pair", { token: secret });
}

export async function leave(): Promise<void> {
  await post("/api/leave", {});
}

export async function recordings(): Promise<Recordings> {
  return (await get("/api/recordings")) as Recordings;
}

export async function captures(recording: string): Promise<Captures> {
  return (await get(`/api/recordings/${encodeURIComponent(recording)}`)) as Captures;
}

export async function state(): Promise<{ status: Record<string, unknown> | null; age_ms: number | null }> {
  return (await get("/api/state")) as { status: Record<string, unknown> | null; age_ms: number | null };
}

/** What the cameras showed after a number; waits for something new. */
export async function look(since: number): Promise<Look> {
  return (await get(`/api/look?since=${since}`)) as Look;
}

/** Where a file of a model is. */
export function file(recording: string, capture: string, name: string): string {
  return `/api/models/${encodeURIComponent(recording)}/${encodeURIComponent(capture)}/${name}`;
}

export async function report(recording: string, capture: string): Promise<Record<string, unknown>> {
  return (await get(file(recording, capture, "report.json"))) as Record<string, unknown>;
}

/** How far two surfaces are apart, in mm; without `places` of an older page's process. */
export interface Apart {
  same: boolean;
  a_to_b: { mean_mm: number; median_mm: number; p90_mm: number; max_mm: number };
  b_to_a: { mean_mm: number; median_mm: number; p90_mm: number; max_mm: number };
  growth_mm: number;
}

/** How far a model's surface is from that of another model, and a picture of that; asked for until `left` says so. */
export async function difference(recording: string, capture: string, other: Summary, left: AbortSignal): Promise<[Apart, Blob]> {
  const names = [other.recording, other.capture].map(encodeURIComponent).join("/");
  const [found, bytes] = await withPictures(file(recording, capture, `difference/${names}`), left);
  return [found as Apart, jpeg(bytes)];
}

/** Models of the object that a capture shows, of other recordings; `whole` if all of them were looked through. */
export async function related(recording: string, capture: string): Promise<{ captures: Summary[]; whole: boolean }> {
  return (await get(file(recording, capture, "related"))) as { captures: Summary[]; whole: boolean };
}

/** A camera's photograph of a capture, small; without a picture, why there is none. */
export interface Photograph {
  camera: string;
  width: number;
  height: number;
  picture: Blob | null;
  words: string;
}

/** The photographs of a capture; none if its recording is not there any more. Asked for until `left` says so. */
export async function photographs(recording: string, capture: string, left: AbortSignal): Promise<Photograph[]> {
  const [found, bytes] = await withPictures(file(recording, capture, "photographs"), left);
  let begin = 0;
  return (found as { camera: string; width?: number; height?: number; bytes?: number; words?: string }[]).map((told) => {
    const end = begin + (told.bytes ?? 0);
    const picture = told.bytes ? jpeg(bytes.subarray(begin, end)) : null;
    begin = end;
    const { camera, width = 0, height = 0, words = "" } = told;
    return { camera, width, height, picture, words };
  });
}

/** Where one camera's photograph of a capture is, in a size that shows whether it is sharp. */
export function photograph(recording: string, capture: string, camera: string): string {
  return file(recording, capture, `photographs/${encodeURIComponent(camera)}`);
}

function jpeg(bytes: Uint8Array<ArrayBuffer>): Blob {
  return new Blob([bytes], { type: "image/jpeg" });
}

/** Comes after a time, or when one signal does. Not every browser has `AbortSignal.any`. */
function within(patience_ms: number, left: AbortSignal): AbortSignal {
  const either = new AbortController();
  const end = () => either.abort();
  if (left.aborted) end();
  left.addEventListener("abort", end, { once: true });
  setTimeout(end, patience_ms);
  return either.signal;
}

/** A line of JSON, and the bytes behind it. A browser has six connections: nobody waits for what was left. */
async function withPictures(address: string, left: AbortSignal): Promise<[unknown, Uint8Array<ArrayBuffer>]> {
  let bytes: Uint8Array<ArrayBuffer>;
  try {
    const response = await fetch(address, { signal: within(60_000, left) });
    if (!response.ok) {
      const { code, words } = (await response.json()) as { code: string; words: string };
      throw new Refused(code, words, response.status);
    }
    bytes = new Uint8Array(await response.arrayBuffer());
  } catch (error) {
    throw error instanceof Refused ? error : new Refused("network", String(error), 0);
  }
  const end = bytes.indexOf(10);
  return [JSON.parse(new TextDecoder().decode(bytes.subarray(0, end))), bytes.subarray(end + 1)];
}

export async function plates(): Promise<Answer> {
  return (await post("/api/plates", {})) as Answer;
}

export async function session(name: string | null, about: Record<string, string>): Promise<Answer> {
  return (await post("/api/session", { name, about })) as Answer;
}

export async function note(capture: string, kind: string, text: string, author: string): Promise<Answer> {
  return (await post("/api/note", { capture, kind, text, author })) as Answer;
}

export async function remake(capture: string, settings: Record<string, number | string>): Promise<Answer> {
  return (await post("/api/remake", { capture, settings })) as Answer;
}

/** Presses; `pressed_ms` is when somebody did, by the clock of the page's process; it is sent only if it is known. */
export async function sendPress(press_id: string, subject: string, placement: string, pressed_ms: number | null): Promise<Answer> {
  return (await post("/api/press", { press_id, subject, placement, pressed_ms: pressed_ms ?? undefined })) as Answer;
}
