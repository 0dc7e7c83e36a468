// What the browser tests share: one rig, and pages that are watched for errors and for requests that leave the machine.
import { expect, test as base } from "@playwright/test";
import { Rig } from "./rig.mjs";

export const test = base.extend({
  rig: [
    async ({}, use) => {
      const rig = new Rig();
      try {
        await rig.start().catch((error) => {
          console.log(rig.lastWords());
          throw error;
        });
        await use(rig);
      } finally {
        await rig.end();
      }
    },
    { scope: "worker", timeout: 120_000 },
  ],
  // No process of the rig ends by itself; of a test that fails, what they logged meanwhile is shown.
  words: [
    async ({ rig }, use, testInfo) => {
      const before = rig.logLengths();
      await use();
      const fallen = rig.fallen.splice(0);
      if (fallen.length > 0 || testInfo.status !== testInfo.expectedStatus) {
        const words = rig.lastWords(before);
        console.log(`${testInfo.title}:\n${words}`);
        await testInfo.attach("logs", { body: words, contentType: "text/plain" });
      }
      expect(fallen, "processes that ended by themselves").toEqual([]);
    },
    { auto: true },
  ],
  // Messages of the browser's console that a test expects.
  expected: async ({}, use) => use([]),
  page: async ({ page, expected }, use) => {
    const watched = watch(page);
    await use(page);
    const isExpected = (text) => expected.some((part) => text.includes(part));
    expect(watched.errors.filter((text) => !isExpected(text))).toEqual([]);
    expect(watched.foreign).toEqual([]);
  },
});

/** Notes a page's errors and the requests that leave the machine. */
export function watch(page) {
  const watched = { errors: [], foreign: [] };
  page.on("console", (message) => message.type() === "error" && watched.errors.push(message.text()));
  page.on("pageerror", (error) => watched.errors.push(String(error)));
  page.on("dialog", (dialog) => watched.errors.push(`dialog: ${dialog.message()}`));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (url.protocol !== "blob:" && !["127.0.0.1", "localhost"].includes(url.hostname)) watched.foreign.push(request.url());
  });
  return watched;
}

/** Opens the page with a session of its own. */
export async function enter(page, rig, role = "operator", port = rig.port) {
  await page.goto(rig.link(role, port));
  await expect(page.locator("nav")).toBeVisible();
}

/** Takes a picture of the top of the page, if pictures are wanted. */
export async function shot(page, name) {
  const folder = process.env.SCREENSHOTS;
  if (!folder) return;
  await page.evaluate(() => scrollTo(0, 0));
  await page.screenshot({ path: `${folder}/page-${name}.png` });
}

/** Waits until the large sign is one of these. */
export async function sign(page, ...names) {
  const pattern = new RegExp(`^(${names.join("|")})$`);
  await expect(page.locator("[data-sign]")).toHaveAttribute("data-sign", pattern, { timeout: 40_000 });
}

export { expect };
