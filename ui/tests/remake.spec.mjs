// A model that is made again with other settings.
import { enter, expect, inGerman, make, shot, test } from "./fixtures.mjs";
import { until } from "./rig.mjs";

test("a model is made again with other settings, beside the first", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  rig.scand("trigger", "--socket", "scand.sock", "--until", "done");
  await expect(page.locator(".facts a")).toBeVisible();
  const name = await page.locator(".facts a").textContent();
  await page.locator(".facts a").click();
  await page.getByText("Make it again with other settings").click();
  // What stays as it is configured is told, and not what is usual.
  const cells = page.getByLabel("Cells along the object");
  await expect(cells).toHaveAttribute("placeholder", `as configured: ${rig.options.resolution}`);
  await expect(page.getByLabel("Darkest shadow")).toHaveAttribute("placeholder", "as configured: 0.12");
  await expect(page.getByLabel("Strongest light of the object")).toHaveAttribute("placeholder", "as configured: 0.06");
  await expect(page.getByLabel("Facets between the views").locator("option").first()).toHaveText("as configured: smoothed");
  const shadow = page.getByLabel("Dunkelster Schatten"); // German
  await inGerman(page, () => expect(shadow).toHaveAttribute("placeholder", "wie eingestellt: 0,12")); // German
  await page.getByRole("button", { name: "Make it again", exact: true }).click();
  await expect(page.locator(".remake .told")).toContainText("at least one setting");
  await cells.fill("60");
  await page.getByRole("button", { name: "Make it again", exact: true }).click();
  await expect(page.locator(".remake .told")).toHaveText(/^Waiting: the model of .* is made again/);
  const link = page.locator("[data-remade] a");
  await expect(link).toHaveText(`${name}.remake-1`, { timeout: 60_000 });
  // It does not wait any more.
  await expect(page.locator(".remake .told")).toHaveText("");
  await link.click();
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await expect(page.locator("scand-say")).toHaveCount(0);
  await page.getByLabel("Compare with another model").selectOption(name);
  await expect(page.locator("[data-compared]")).toContainText("cm³");
  await expect(page.locator("[data-compared] thead")).toContainText(name);
  await page.locator("[data-measure-surfaces]").click();
  await expect(page.locator("[data-apart]")).toContainText(/\d\.\d\d/, { timeout: 60_000 });
  await expect.poll(() => page.locator("scand-compare .enlarge img").evaluate((img) => img.naturalWidth)).toBeGreaterThan(500);
  await shot(page, "compared");
  // What people say of the capture holds for its other models too.
  rig.scand("note", "--socket", "scand.sock", name, "reject", "a hand");
  await expect(page.locator("p.row > .decision")).toHaveText("rejected");
  await expect(page.locator("[data-compared] .decision").first()).toHaveText("rejected");
});

/** Asks for so many remakes of a capture, as the page does, each with other settings; how each was answered. */
function askForRemakes(page, capture, count) {
  const ask = async ({ capture, count }) => {
    const { token } = await (await fetch("/api/me")).json();
    const headers = { "Content-Type": "application/json", "X-Scand-Token": token };
    const answers = [];
    for (let n = 0; n < count; n++) {
      const body = JSON.stringify({ capture, settings: { "hull.resolution": 40 + n / 100 } });
      const answer = await fetch("/api/remake", { method: "POST", headers, body });
      answers.push((await answer.json()).type);
    }
    return answers;
  };
  return page.evaluate(ask, { capture, count });
}

test("no more than ten remakes wait, and an eleventh is refused in words", async ({ page, rig }) => {
  test.setTimeout(240_000);
  await rig.prepare();
  await enter(page, rig);
  const [recording, capture] = make(rig);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  await page.getByText("Make it again with other settings").click();
  expect(await askForRemakes(page, capture, 10)).toEqual(Array(10).fill("ok"));
  // One of them is being made, so that there is room for another one, and further ones as they are made.
  const told = page.locator(".remake .told");
  const asked = [];
  while (asked.length < 15 && !asked.at(-1)?.startsWith("Refused")) {
    await page.getByLabel("Cells along the object").fill(String(41 + asked.length));
    const answered = page.waitForResponse("**/api/remake");
    await page.getByRole("button", { name: "Make it again", exact: true }).click();
    await answered;
    await expect(told).toHaveText(/^(Refused|Waiting): /);
    asked.push(await told.textContent());
  }
  expect(asked.at(-1)).toBe("Refused: 10 remakes wait already: try again when one is done");
  const { remakes } = rig.status().models;
  expect(remakes).toBeLessThanOrEqual(11);
  // The other cases have the processors for themselves.
  await until("all are made", () => rig.status().models.remakes === 0, 150);
});
