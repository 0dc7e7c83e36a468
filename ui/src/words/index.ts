// The catalogue: words by key in the language that was chosen, with values put in as text.
import { de } from "./de";
import { en, type Key, type Words } from "./en";

export type { Key };

const languages: Record<string, Words> = { en, de };
const STORED = "scand-language";

let current = chosen();

function chosen(): string {
  const wanted = [localStorage.getItem(STORED) ?? "", ...navigator.languages.map((tag) => tag.slice(0, 2))];
  return wanted.find((name) => name in languages) ?? "en";
}

export function language(): string {
  return current;
}

/** The other languages, as [tag, name]. */
export function others(): [string, string][] {
  const all = Object.entries(languages).map(([tag, words]): [string, string] => [tag, words.language]);
  return all.filter(([tag]) => tag !== current);
}

export function choose(tag: string): void {
  current = tag in languages ? tag : "en";
  localStorage.setItem(STORED, current);
}

/** Whether the catalogue has words under this key. */
export function isKey(key: string): key is Key {
  return Object.hasOwn(en, key);
}

export function t(key: Key, values: Record<string, string | number> = {}): string {
  const text = languages[current][key];
  return text.replace(/\{(\w+)\}/g, (whole, name: string) => (name in values ? String(values[name]) : whole));
}

/** Words with a number `n`; there are words of their own for one. */
export function counted(key: Key, n: number): string {
  const one = `${key}_one`;
  return n === 1 && isKey(one) ? t(one) : t(key, { n });
}

/** A number as the page's language writes it, with a number of digits behind the decimal separator. */
export function number(value: number, digits: number): string {
  return format(value, digits, "auto");
}

/** A number with the digits that it has, at most six behind the decimal separator, as somebody would type it. */
export function plain(value: number): string {
  return new Intl.NumberFormat(current, { maximumFractionDigits: 6, useGrouping: false }).format(value);
}

/** A difference: a number with its sign, unless it rounds to zero. */
export function difference(value: number, digits: number): string {
  return format(value, digits, "exceptZero");
}

function format(value: number, digits: number, signDisplay: "auto" | "exceptZero"): string {
  const shown = { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay };
  return new Intl.NumberFormat(current, shown).format(value);
}

/** A length of time in words, from milliseconds. */
export function age(ms: number): string {
  const seconds = Math.max(0, ms / 1000);
  if (seconds < 90) return t("age_seconds", { n: Math.round(seconds) });
  if (seconds < 90 * 60) return t("age_minutes", { n: Math.round(seconds / 60) });
  if (seconds < 48 * 3600) return t("age_hours", { n: Math.round(seconds / 3600) });
  return t("age_days", { n: Math.round(seconds / 86400) });
}
