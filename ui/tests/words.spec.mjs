// The daemon's words in the language of the page.
import { enter, expect, test } from "./fixtures.mjs";

test("reasons are in the page's language, and a list that is cut says so", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const reasons = [
    { level: "red", code: "frame_cut", words: "c03 cuts it" },
    { level: "amber", code: "of_another_version", words: "<b>new</b>" },
    { level: "amber", code: "blurred", words: "the object's outline is blurred: c00 (3.0 px), c02 (2.1 px), 2 more" },
    { level: "amber", code: "depth_biased", words: "depth is off by more than its calibration allows: kinect (5.1 mm more); 9.3 mm in all" },
    { level: "amber", code: "of_another_version", words: "depth camera kinect gave 7 frames from -50.0 to 900.0 ms after the trigger, expected at least 10" },
  ];
  const capture = { capture: "fake-0001", recording: "fake", verdict: "red", reasons, subject: null, placement: null, time_s: null };
  const rest = { decision: null, notes: [], has_preview: false, has_model: false, model_tag: null };
  await page.route("**/api/recordings/fake", (route) => route.fulfill({ json: { captures: [{ ...capture, ...rest }], all: 1201 } }));
  await page.route("**/report.json", (route) => route.fulfill({ json: {} }));
  await page.route("**/photographs", (route) => route.fulfill({ body: "[]\n" }));
  await page.getByRole("button", { name: "Deutsch" }).click();
  await page.evaluate(() => (location.hash = "#/history/fake"));
  await expect(page.locator(".strip .quiet")).toContainText("reicht bis an den Rand eines Bildes.");
  await expect(page.locator("[data-cut]")).toContainText("1200");
  await page.locator(".strip a").click();
  await expect(page.locator("main")).toContainText("Rand eines Bildes. c03 cuts it");
  await expect(page.locator("main")).toContainText("<b>new</b>");
  // The details are the daemon's; those that the catalogue has are in the page's language, and the others marked.
  await expect(page.locator("main")).toContainText("der Umriss des Objekts ist unscharf: c00 (3.0 px), c02 (2.1 px), 2 weitere"); // German
  await expect(page.locator("main")).toContainText("kinect (5.1 mm mehr); insgesamt 9.3 mm");
  await expect(page.locator("main")).toContainText("Tiefenkamera kinect zwischen -50.0 und 900.0 ms nach dem Auslösen: 7, nötig");
  await expect(page.locator("main [lang=en]")).toHaveText(["c03 cuts it", "<b>new</b>"]);
  await page.getByRole("button", { name: "English" }).click();
  await expect(page.locator("main")).toContainText("the object's outline is blurred: c00 (3.0 px), c02 (2.1 px), 2 more");
});
