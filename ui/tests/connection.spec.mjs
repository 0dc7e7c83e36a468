// What a page shows when its connection breaks, when it slept, and when nothing answers as it is opened.
import { closeSession, enter, expect, shot, sign, test } from "./fixtures.mjs";

test("a connection that falls silent is told, and what is shown is so again when it is back", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await enter(page, rig, "viewer", rig.wirePort);
  await sign(page, "ready", "green", "amber");
  rig.wire.cut();
  await sign(page, "unknown");
  await expect(page.locator(".facts li")).toHaveCount(0);
  await shot(page, "unknown");
  // Meanwhile the page's process was replaced by one of another version.
  await page.route("**/api/me", async (route) => {
    try {
      const me = await (await route.fetch()).json();
      await route.fulfill({ json: { ...me, version: "99.0.0" } });
    } catch {
      // It was asked over the wire that is cut.
      await route.abort().catch(() => {});
    }
  });
  await page.evaluate(() => (window.isFirst = true));
  const asked = page.waitForResponse("**/api/me");
  rig.wire.mend();
  await sign(page, "ready", "green", "amber");
  await asked;
  expect(await page.evaluate(() => window.isFirst)).toBe(true);
  await page.getByRole("link", { name: "State" }).click();
  await page.waitForFunction(() => !window.isFirst);
  await expect(page.locator("main")).toContainText("Version of the page: 99.0.0");
});

test("a tablet that slept shows nothing old when it wakes, by the clock on the wall", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await enter(page, rig, "viewer", rig.wirePort);
  await sign(page, "ready", "green", "amber", "red", "failed");
  rig.wire.cut();
  // The monotonic clock stood still meanwhile; by it alone the last word would count for six seconds at least.
  await page.evaluate(() => {
    const now = Date.now.bind(Date);
    Date.now = () => now() + 3_600_000;
  });
  await expect(page.locator("[data-sign]")).toHaveAttribute("data-sign", "unknown", { timeout: 4000 });
  rig.wire.mend();
  await sign(page, "ready", "green", "amber", "red", "failed");
});

test("a page that is opened while the rig does not answer says so, and goes on by itself", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await enter(page, rig, "viewer");
  await page.route("**/api/me", (route) => route.abort());
  await page.reload();
  await expect(page.getByRole("heading", { name: "No connection" })).toBeVisible();
  await expect(page.locator("pre")).toHaveCount(0);
  await page.unroute("**/api/me");
  await expect(page.locator("nav")).toBeVisible();
});

test("while nobody knows whether a session is open, none is offered to be begun, and what was typed stays", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await enter(page, rig, "operator", rig.wirePort);
  await closeSession(page);
  const [begin, name] = [page.getByRole("button", { name: "Begin the session" }), page.getByLabel("Name of the session")];
  const unknown = page.getByText("Whether a session is open is not known at the moment.");
  await expect(unknown).toHaveCount(0);
  await name.fill("half a na");
  rig.wire.cut();
  await expect(unknown).toBeVisible();
  await expect(begin).toBeHidden();
  rig.wire.mend();
  await expect(begin).toBeVisible();
  await expect(unknown).toHaveCount(0);
  await expect(name).toHaveValue("half a na");
  // A page that is opened, before it hears what holds.
  await page.route("**/api/events", (route) => route.abort());
  await page.reload();
  await expect(unknown).toBeVisible();
  await expect(begin).toBeHidden();
  await page.unroute("**/api/events");
  await expect(begin).toBeVisible();
});
