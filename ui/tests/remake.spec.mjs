// A model that is made again with other settings.
import { enter, expect, shot, test } from "./fixtures.mjs";

test("a model is made again with other settings, beside the first", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  rig.scand("trigger", "--socket", "scand.sock", "--until", "done");
  await expect(page.locator(".facts a")).toBeVisible();
  const name = await page.locator(".facts a").textContent();
  await page.locator(".facts a").click();
  await page.getByText("Make it again with other settings").click();
  await page.getByRole("button", { name: "Make it again", exact: true }).click();
  await expect(page.locator(".remake .told")).toContainText("at least one setting");
  await page.getByLabel("Cells along the object").fill("60");
  await page.getByRole("button", { name: "Make it again", exact: true }).click();
  await expect(page.locator(".remake .told")).toContainText("is made again");
  const link = page.locator("[data-remade] a");
  await expect(link).toHaveText(`${name}.remake-1`, { timeout: 60_000 });
  await link.click();
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await expect(page.locator("scand-say")).toHaveCount(0);
  await page.getByLabel("Compare with another model").selectOption(name);
  await expect(page.locator("[data-compared]")).toContainText("cm³");
  await expect(page.locator("[data-compared] thead")).toContainText(name);
  await page.locator("[data-measure-surfaces]").click();
  await expect(page.locator("[data-apart]")).toContainText(/\d\.\d\d/, { timeout: 60_000 });
  await expect.poll(() => page.locator("scand-compare img").evaluate((img) => img.naturalWidth)).toBeGreaterThan(500);
  await shot(page, "compared");
  // What people say of the capture holds for its other models too.
  rig.scand("note", "--socket", "scand.sock", name, "reject", "a hand");
  await expect(page.locator("p.row > .decision")).toHaveText("rejected");
  await expect(page.locator("[data-compared] .decision").first()).toHaveText("rejected");
});
