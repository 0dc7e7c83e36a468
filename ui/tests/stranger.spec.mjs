// A way through the page by the words on the screen alone, as somebody goes it who has never seen it.
import { enter, expect, test } from "./fixtures.mjs";

test("a stranger who has only the page takes background pictures, scans an object twice, rejects one and finds the better model", async ({ page, rig }) => {
  test.setTimeout(240_000);
  const slow = { timeout: 60_000 };
  const number = `1999.${Date.now()}`;
  await rig.show("background");
  const begun = Date.now();
  await enter(page, rig);
  // The page says what to do; what is clicked is what a person reads there.
  const click = (name) => page.getByRole("button", { name, exact: true }).click();
  await click("Take background pictures");
  await expect(page.getByText("Is the rig empty?")).toBeVisible();
  await click("Yes, take them");
  await expect(page.getByText("Put the object in now.")).toBeVisible();
  rig.isPrepared = true;
  await rig.show("captures");
  const stored = page.getByText(/ is safe on the disk\.$/);
  const scans = [];
  for (let n = 0; n < 2; n++) {
    await page.getByLabel("Number of the object").fill(number);
    await click("Press");
    const name = async () => (await stored.textContent()).trim().split(" ")[0];
    await expect.poll(name).not.toBe(scans.at(-1));
    scans.push(await name());
    const last = page.getByRole("listitem").filter({ hasText: `Last capture: ${scans.at(-1)}` });
    await expect(last).toContainText(/Model (green|amber)/, slow);
  }
  const [first, second] = scans;
  await page.getByLabel("Why, or a note").fill("My hand was in it.");
  await click("Reject");
  await expect(page.getByText(`The note on ${second} is stored.`)).toBeVisible();
  // In the history the card that has the number, a good verdict and no "rejected" is the one.
  await page.getByRole("link", { name: "History" }).click();
  const cards = page.getByRole("main").getByRole("link").filter({ hasText: number });
  const ofCaptures = cards.filter({ hasNotText: "All captures together" });
  await expect(ofCaptures).toHaveCount(2);
  await expect(ofCaptures.filter({ hasText: "rejected" })).toHaveCount(1);
  await ofCaptures.filter({ hasText: /Green|Amber/ }).filter({ hasNotText: "rejected" }).click();
  await expect(page.getByRole("heading", { name: first })).toBeVisible();
  await expect(page.getByRole("application", { name: /The model in three dimensions/ })).toBeVisible();
  // There is something to measure once the model is there.
  await expect(async () => {
    await click("Measure a distance");
    await expect(page.getByText("Tap the first point.")).toBeVisible({ timeout: 500 });
  }).toPass(slow);
  await page.getByLabel("Compare with another model").selectOption({ label: `${second} (${number})` });
  const verdicts = page.getByRole("row").filter({ has: page.getByRole("rowheader", { name: "Verdict" }) });
  await expect(verdicts).toContainText("rejected");
  const errors = page.getByRole("row").filter({ has: page.getByRole("rowheader", { name: "Mean expected error" }) });
  await expect(errors).toContainText("mm");
  await expect(page.getByText("Look at the verdict first")).toBeVisible();
  const seconds = (Date.now() - begun) / 1000;
  console.log(`a stranger's way from the link to the better model: ${seconds.toFixed(1)} s`);
  expect(seconds).toBeLessThan(180);
});
