// What the browser tests share: one rig, pages that are watched for errors and for requests that leave the machine, and
// what several cases do with them. A case may find captures, background pictures and an open session of those before
// it; which cases ran before, it does not know.
import { expect, test as base } from "@playwright/test";
import { Rig } from "./rig.mjs";

export const test = base.extend({
  rig: [
    async ({}, use) => {
      // Not the default, so that what the page shows is what the daemon tells.
      const rig = new Rig({ platesLimit: 36 });
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

/** Takes a capture and waits for its model; recording and name of that. */
export function make(rig) {
  const lines = rig.scand("trigger", "--socket", "scand.sock", "--until", "done", "--json").trim().split("\n");
  return JSON.parse(lines.pop()).model.split("/").slice(-2);
}

/** How many captures the rig took since the daemon began. */
export const taken = (rig) => rig.status().complete;

/** Presses on the page for an object; the capture's name, once it is on the disk. */
export async function pressFor(page, rig, number) {
  const before = taken(rig);
  await page.getByLabel("Number of the object").fill(number);
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await expect.poll(() => taken(rig)).toBe(before + 1);
  const told = page.locator(".do > .told");
  await expect(told).toContainText("safe on the disk");
  return (await told.textContent()).trim().split(" ")[0];
}

/** Closes the session that another case left open, if one did. */
export async function closeSession(page) {
  const [begin, close] = ["Begin the session", "Close the session"].map((name) => page.getByRole("button", { name }));
  await expect(begin.or(close)).toBeVisible();
  if (await close.isVisible()) await close.click();
  await expect(begin).toBeVisible();
}

/** Looks at something on the German page, and goes on with the English one. */
export async function inGerman(page, look) {
  await page.getByRole("button", { name: "Deutsch" }).click();
  await look();
  await page.getByRole("button", { name: "English" }).click();
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
