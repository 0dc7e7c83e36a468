// What the daemon says in words alone, in the page's language: the catalogue has its sentences, with names in place of
// what differs, and parts of lists and of other sentences, among these the usual errors of the operating system. What it
// does not have stays as the daemon said it.
import { html, type TemplateResult } from "lit";
import { en } from "./en";
import { isKey, type Key, language, t } from "./index";

interface Sentence {
  key: Key;
  names: string[];
  pattern: RegExp;
}

/** A piece of what is shown. One that the catalogue does not have stays English. */
interface Piece {
  words: string;
  isForeign: boolean;
}

/** A longer text is no single sentence. A text of more parts between semicolons is not looked through. */
const LONGEST = 500;
const MOST_OF_ALL = 60;
/** Most parts between semicolons that one sentence of the daemon has. */
const MOST_PARTS = 6;
/** Texts of which it is remembered what they are in the page's language. */
const MOST_REMEMBERED = 500;
/** What may stand for a name, by the name; for any other name there may be anything. */
const HELD: [RegExp, string][] = [
  [/^n(_\w+)?$/, "([-+]?\\d[\\d.]*)"],
  [/^share(_\w+)?$/, "(-?[\\d.]+ %)"],
  // Such as "3 places"; other languages have the number alone.
  [/^count$/, "(\\d+) [a-z ]+?"],
  [/^frames$/, "(no frame|\\d+(?= frames?))(?: frames?)?"],
  [/^length$/, "(-?[\\d.]+ mm)"],
  [/^(camera|name)$/, "([\\w.-]+)"],
  [/^cameras$/, "([^;]+?)"],
  [/^kind$/, "(colour|depth)"],
  [/^action$/, "(create|write|write to|remove|rename into place)"],
  [/^file$/, "([^\\s:;]+)"],
  [/^cause$/, "([^:;]+ \\(os error \\d+\\))"],
  // Where there may be nothing.
  [/^rest$/, "((?:: .+)?)"],
  [/^doubts$/, "((?:; .+)?)"],
  [/^place$/, "((?: \\(.+\\))?)"],
  [/^advice$/, "((?:: .+)?)"],
];
/** Names of what the daemon says in words: a sentence of its own, or several. */
const SPOKEN = ["reason", "why", "words", "consequence", "shortfall", "rest", "doubts", "place", "cause", "advice"];
/** Names in the place of which people's own names stand, such as a camera's; these have no spaces. */
const NAMED = ["camera", "name", "capture", "other"];
const NAMES = /\{(\w+)\}/;

const sentences = ofCatalogue("said_");
/** What the operating system says of an error. */
const causes = [...ofCatalogue("os_"), ...ofCatalogue("kind_")];
const parts = [...ofCatalogue("part_"), ...causes];
const remembered = new Map<string, Piece[]>();

function ofCatalogue(prefix: string): Sentence[] {
  return Object.keys(en)
    .filter(isKey)
    .filter((key) => key.startsWith(prefix))
    .map(sentence);
}

/** The daemon's sentence under a key: its English words, and what stands where they have a name. */
function sentence(key: Key): Sentence {
  const names: string[] = [];
  // The beginning joins some sentences to the one before.
  const pieces = en[key].replace(/^[;:] /, "").split(NAMES);
  const pattern = pieces.map((piece, place) => {
    if (place % 2 === 0) return piece.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
    names.push(piece);
    return held(piece);
  });
  return { key, names, pattern: new RegExp(`^${pattern.join("")}$`) };
}

/** What may stand for a name, as a pattern. */
function held(name: string): string {
  return HELD.find(([names]) => names.test(name))?.[1] ?? "(.+?)";
}

function own(words: string): Piece {
  return { words, isForeign: false };
}

function foreign(words: string): Piece {
  return { words, isForeign: true };
}

/** A text in the page's language by the first sentence that it is; null if it is none. */
function matched(text: string, known: Sentence[]): Piece[] | null {
  for (const { key, names, pattern } of known) {
    const found = pattern.exec(text);
    if (!found) continue;
    const values = new Map(names.map((name, place): [string, string] => [name, found[place + 1]]));
    const pieces = t(key).split(NAMES);
    return pieces.flatMap((piece, place) => (place % 2 === 0 ? [own(piece)] : inPlace(piece, values.get(piece) ?? "")));
  }
  return null;
}

/** What stands in place of a name. */
function inPlace(name: string, value: string): Piece[] {
  if (name === "cameras") return [own(value.split(", ").map(ofList).join(", "))];
  const part = NAMED.includes(name) && !value.includes(" ") ? null : matched(value, parts);
  if (part !== null || !SPOKEN.includes(name) || value === "") return part ?? [own(value)];
  const begin = /^(?:; |: )?/.exec(value)?.[0] ?? "";
  return [own(begin), ...several(value.slice(begin.length))];
}

/** One of a list of cameras: `c00`, `c00 (3.1 px)` or `3 more`. */
function ofList(one: string): string {
  const [, name, value] = /^([^ ]+) \((.+)\)$/.exec(one) ?? [];
  if (value !== undefined) return `${name} (${named(value)})`;
  return one.includes(" ") ? named(one) : one;
}

/** The same of a sentence that may begin with the camera or the capture that it is about. */
function ofCamera(text: string): Piece[] | null {
  if (text.length > LONGEST) return null;
  const whole = matched(text, sentences) ?? matched(text, causes);
  if (whole !== null) return whole;
  const [, about, rest] = /^(?:camera |capture )?([\w.-]+(?: of [\w.-]+)?): (.+)$/.exec(text) ?? [];
  const words = rest ? ofCamera(rest) : null;
  return words && [own(`${about}: `), ...words];
}

/** A sentence that the catalogue does not have, at whose end the operating system may have its word. */
function withCause(text: string): Piece[] {
  const [, begin, words] = /^(.*: )([^:]+)$/.exec(text) ?? [];
  const found = words === undefined ? null : matched(words, causes);
  return found === null ? [foreign(text)] : [foreign(begin), ...found];
}

/** Sentences between semicolons, some of which have semicolons themselves. */
function several(text: string): Piece[] {
  const all = text.split("; ");
  if (all.length > MOST_OF_ALL) return [foreign(text)];
  const pieces: Piece[] = [];
  for (let begin = 0; begin < all.length; ) {
    let end = Math.min(all.length, begin + MOST_PARTS);
    let found = ofCamera(all.slice(begin, end).join("; "));
    while (found === null && --end > begin) found = ofCamera(all.slice(begin, end).join("; "));
    if (begin > 0) pieces.push(own("; "));
    pieces.push(...(found ?? withCause(all[begin])));
    begin = Math.max(end, begin + 1);
  }
  return pieces;
}

/** What the daemon said, in the page's language as far as the catalogue has it. */
function translated(text: string): Piece[] {
  if (language() === "en" || text === "") return [own(text)];
  const key = `${language()} ${text}`;
  const pieces = remembered.get(key) ?? several(text);
  if (remembered.size >= MOST_REMEMBERED) remembered.clear();
  remembered.set(key, pieces);
  return pieces;
}

/** What the daemon said, as text. */
export function said(text: string): string {
  return translated(text)
    .map(({ words }) => words)
    .join("");
}

/** Whether the catalogue has all of what the daemon said. */
export function isSaid(text: string): boolean {
  return translated(text).every(({ isForeign }) => !isForeign);
}

/** What the daemon said, marked as English where the catalogue does not have it. */
export function spoken(text: string): TemplateResult {
  const pieces = translated(text);
  return html`${pieces.map(({ words, isForeign }) => (isForeign ? html`<span lang="en">${words}</span>` : words))}`;
}

/** A name or a value of the daemon's, such as that of a setting, in the page's language if the catalogue has it. */
export function named(text: string): string {
  const found = language() === "en" ? null : matched(text, parts);
  return found ? found.map(({ words }) => words).join("") : text;
}
