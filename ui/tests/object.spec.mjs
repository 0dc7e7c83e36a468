// Several captures of one object: how they lie, and the model of all of them.
import { readFileSync } from "node:fs";
import { enter, expect, inGerman, pressFor, shot, test } from "./fixtures.mjs";

/** Of which captures the object's model is that the page links. */
async function fusedCaptures(page, rig) {
  const address = await page.locator("[data-fused] a").getAttribute("href");
  const folder = address.split("/").slice(-2).map(decodeURIComponent).join("/");
  const report = rig.path(`models/${folder}/report.json`);
  try {
    return JSON.parse(readFileSync(report, "utf8")).fusion.captures.map(({ id }) => id);
  } catch {
    // The folder is being replaced.
    return [];
  }
}

test("of several captures of an object the page tells how they lie, and makes their model again as captures come and go", async ({ page, rig }) => {
  test.setTimeout(240_000);
  const slow = { timeout: 60_000 };
  await rig.prepare();
  await enter(page, rig);
  // Characters that no folder's name can have.
  const number = `Inv. 77/${Date.now()}`;
  const first = await pressFor(page, rig, number);
  const second = await pressFor(page, rig, number);
  const object = page.locator(".object");
  const [registered, fused] = [object.locator("[data-registered]"), object.locator("[data-fused]")];
  await expect(object).toContainText(`Object ${number}`, slow);
  await expect(registered).toContainText(second, slow);
  await inGerman(page, () => expect(registered.locator("[lang=en]")).toHaveCount(0));
  await expect(object).toContainText("No camera has seen");
  await expect(object.locator(".next")).toHaveText(/^\s*(Show next: \S|There is no further side to show)/);
  await expect(fused.getByRole("link", { name: "Model of all captures" })).toBeVisible(slow);
  expect(await fusedCaptures(page, rig)).toEqual([first, second]);
  await shot(page, "several");
  // A third capture is not in the model yet, and the page says so until it is.
  const isOld = /from before/;
  const holds = object.locator("[data-holds-captures]");
  await expect(holds).toHaveText(`Made of the captures ${first}, ${second}.`);
  await expect(fused).not.toContainText(isOld);
  const third = await pressFor(page, rig, number);
  await expect(fused).toContainText(`from before capture ${third} was taken`);
  await expect(registered).toContainText(third, slow);
  await expect.poll(() => fusedCaptures(page, rig), slow).toEqual([first, second, third]);
  await expect(fused).not.toContainText(isOld, slow);
  // A rejected capture is left out, and what was told of how it lies is marked.
  await page.getByLabel("Why, or a note").fill("it rolled");
  await page.locator("[data-say=reject]").click();
  await expect(page.locator(".say .told")).toHaveText(`Capture ${third} is rejected: it rolled`);
  await expect(registered).toContainText(`from before capture ${third} was rejected`);
  await expect.poll(() => fusedCaptures(page, rig), slow).toEqual([first, second]);
  await expect(fused).not.toContainText(isOld, slow);
  await expect(holds).toHaveText(`Made of the captures ${first}, ${second}.`);
  await expect(registered).toContainText(isOld);
  // The viewer shows the model anew when the reject is taken back.
  await fused.getByRole("link").click();
  await expect(page.locator("h1")).toHaveText("All captures together");
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  const again = page.waitForResponse((answer) => answer.url().endsWith("view.glb"), slow);
  rig.scand("note", "--socket", "scand.sock", third, "clear");
  await again;
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
});
