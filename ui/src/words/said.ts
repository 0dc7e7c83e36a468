// What the daemon says in words alone, in the page's language: the catalogue has its sentences, with names in place of
// what differs. A sentence that it does not have stays as the daemon said it.
import { html, type TemplateResult } from "lit";
import { en } from "./en";
import { isKey, type Key, language, t } from "./index";

interface Sentence {
  key: Key;
  names: string[];
  pattern: RegExp;
}

/** A longer text is no single sentence. */
const LONGEST = 500;

const sentences: Sentence[] = Object.keys(en)
  .filter(isKey)
  .filter((key) => key.startsWith("said_"))
  .map(sentence);

/** The daemon's sentence under a key: its English words, and what stands where they have a name. */
function sentence(key: Key): Sentence {
  const names: string[] = [];
  const parts = en[key].split(/\{(\w+)\}/).map((part, place) => {
    if (place % 2 === 0) return part.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
    names.push(part);
    return "(.+?)";
  });
  return { key, names, pattern: new RegExp(`^${parts.join("")}$`) };
}

/** A sentence in the page's language; null if the catalogue does not have it. */
function known(text: string): string | null {
  for (const { key, names, pattern } of sentences) {
    const found = pattern.exec(text);
    if (found) return t(key, Object.fromEntries(names.map((name, place) => [name, found[place + 1]])));
  }
  return null;
}

/** The same of a sentence that may begin with the camera that it is about. */
function knownOfCamera(text: string): string | null {
  const whole = known(text);
  if (whole !== null) return whole;
  const [, camera, rest] = /^(?:camera )?([\w.-]+): (.+)$/.exec(text) ?? [];
  const words = rest ? known(rest) : null;
  return words === null ? null : `${camera}: ${words}`;
}

/** What the daemon said, in the page's language as far as the catalogue has it, and whether it has all of it. */
function translated(text: string): { words: string; isWhole: boolean } {
  if (language() === "en" || text.length > LONGEST) return { words: text, isWhole: language() === "en" };
  const whole = knownOfCamera(text);
  if (whole !== null) return { words: whole, isWhole: true };
  const parts = text.split("; ").map((part) => [knownOfCamera(part), part]);
  return { words: parts.map(([words, part]) => words ?? part).join("; "), isWhole: parts.every(([words]) => words !== null) };
}

/** What the daemon said, as text. */
export function said(text: string): string {
  return translated(text).words;
}

/** What the daemon said, marked as English where the catalogue does not have it. */
export function spoken(text: string): TemplateResult {
  const { words, isWhole } = translated(text);
  return isWhole ? html`${words}` : html`<span lang="en">${words}</span>`;
}
