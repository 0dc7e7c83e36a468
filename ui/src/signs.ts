// Signs: each has a form of its own, so that neither colour nor language is needed to tell one from another.
import { type SVGTemplateResult, svg, html, type TemplateResult } from "lit";
import type { Now } from "./api";

const circle = svg`<circle cx="12" cy="12" r="10"/>`;
const tick = svg`<path d="M7 12.5l3.5 3.5L17 8.5"/>`;
const cross = svg`<path d="M8 8l8 8M16 8l-8 8"/>`;

const forms: Record<string, SVGTemplateResult> = {
  unknown: svg`<path d="M3 9a13 13 0 0 1 18 0M6.5 12.5a8 8 0 0 1 11 0M10 16a3 3 0 0 1 4 0M4 20L20 4"/>`,
  away: svg`${circle}<path d="M9 9.5a3 3 0 1 1 4.5 2.6c-1 .6-1.5 1-1.5 2.4M12 17.5v.01"/>`,
  not_ready: svg`<path d="M4 8h4l1.500-2h5L16 8h4v11H4zM3 3l18 18"/>`,
  disk_full: svg`<ellipse cx="12" cy="6" rx="8" ry="3"/><path d="M4 6v12c0 4 16 4 16 0V6M12 11v4M12 18v.01"/>`,
  busy: svg`<path d="M6 3h12M6 21h12M7 3c0 5 3.500 7 5 9-1.500 2-5 4-5 9M17 3c0 5-3.500 7-5 9 1.500 2 5 4 5 9"/>`,
  ready: svg`${circle}<path d="M10 7.500v9l7-4.500z"/>`,
  ready_no_plates: svg`<path d="M3 5h18v14H3zM3 19L21 5M8.500 11v.01M15.500 14v.01"/>`,
  ready_without: svg`${circle}<path d="M8 8v8l6-4zM17 8v4.500M17 16v.01"/>`,
  capturing: svg`<path d="M8 21l-4-7 1.500-1 2.500 2V6.500a1.500 1.500 0 0 1 3 0V4.500a1.500 1.500 0 0 1 3 0v2a1.500 1.500 0 0 1 3 0V9a1.500 1.500 0 0 1 3 0v7l-2 5z"/>`,
  hands_may_move: svg`<path d="M2 12h20M6 8l-4 4 4 4M18 8l4 4-4 4"/>`,
  safe: svg`<path d="M12 3v11M8 10l4 4 4-4M4 15v5h16v-5"/>`,
  green: svg`${circle}${tick}`,
  amber: svg`<path d="M12 3l10 18H2zM12 10v5M12 18v.01"/>`,
  red: svg`<path d="M8 2h8l6 6v8l-6 6H8l-6-6V8z"/>${cross}`,
  failed: svg`<path d="M20 12a8 8 0 1 1-2.500-5.800M20 3v5h-5"/>`,
  model_failed: svg`<path d="M12 2l9 5v10l-9 5-9-5V7z"/>${cross}`,
  retried: svg`<path d="M20 12a8 8 0 1 1-2.500-5.800M20 3v5h-5"/>`,
  outcome_unknown: svg`${circle}<path d="M9 9.5a3 3 0 1 1 4.5 2.6c-1 .6-1.5 1-1.5 2.4M12 17.5v.01"/>`,
  unread: svg`<path d="M5 2h10l4 4v16H5zM9 12h6M9 16h6"/>`,
};

/** What is shown as the sign: where only background pictures are missing, not the one that says that all is well. */
export function shown(now: Now | null): string {
  const name = now?.sign ?? "unknown";
  return name === "ready" && now?.daemon?.plates_age_h === null ? "ready_no_plates" : name;
}

export function sign(name: string): TemplateResult {
  const form = forms[name] ?? forms.unknown;
  return html`<svg class="sign" viewBox="0 0 24 24" aria-hidden="true" focusable="false">${form}</svg>`;
}
