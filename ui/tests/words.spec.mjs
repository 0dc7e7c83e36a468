// The daemon's words in the language of the page.
import { enter, expect, inGerman, test } from "./fixtures.mjs";

test("reasons are in the page's language, and a list that is cut says so", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const reasons = [
    { level: "red", code: "frame_cut", words: "c03 cuts it" },
    { level: "amber", code: "of_another_version", words: "<b>new</b>" },
    { level: "amber", code: "no_depth_camera", words: "no depth camera took part in the capture" },
    { level: "amber", code: "blurred", words: "the object's outline is blurred: c00 (3.0 px), c02 (2.1 px), 2 more" },
    { level: "amber", code: "depth_biased", words: "depth is off by more than its calibration allows: kinect (5.1 mm more); 9.3 mm in all" },
    { level: "amber", code: "of_another_version", words: "depth camera kinect gave 7 frames from -50.0 to 900.0 ms after the trigger, expected at least 10" },
  ];
  const capture = { capture: "fake-0001", recording: "fake", verdict: "red", reasons, subject: null, placement: null, time_s: null };
  const rest = { decision: null, notes: [], has_preview: false, has_model: false, model_tag: null };
  await page.route("**/api/recordings/fake", (route) => route.fulfill({ json: { captures: [{ ...capture, ...rest }], all: 1201 } }));
  const provenance = [{ provenance: "of_another_version", share: 1, mean_expected_error: 0.001 }];
  await page.route("**/report.json", (route) => route.fulfill({ json: { model: { provenance } } }));
  await page.route("**/photographs", (route) => route.fulfill({ body: "[]\n" }));
  await page.getByRole("button", { name: "Deutsch" }).click();
  await page.evaluate(() => (location.hash = "#/history/fake"));
  await expect(page.locator(".strip .quiet")).toContainText("reicht bis an den Rand eines Bildes.");
  await expect(page.locator("[data-cut]")).toContainText("1200");
  await expect(page.locator("#recording")).toHaveValue("fake");
  await page.locator(".strip a").click();
  await expect(page.locator("main")).toContainText("Rand eines Bildes. c03 cuts it");
  await expect(page.locator("main")).toContainText("<b>new</b>");
  await expect(page.getByRole("rowheader", { name: "of_another_version" })).toBeVisible();
  await expect(page.getByRole("cell", { name: "1,00 mm" })).toBeVisible(); // German
  // The details are the daemon's; those that the catalogue has are in the page's language, and the others marked.
  await expect(page.locator("main")).toContainText("der Umriss des Objekts ist unscharf: c00 (3.0 px), c02 (2.1 px), 2 weitere"); // German
  await expect(page.locator("main")).toContainText("kinect (5.1 mm mehr); insgesamt 9.3 mm");
  await expect(page.locator("main")).toContainText("Tiefenkamera kinect zwischen -50.0 und 900.0 ms nach dem Auslösen: 7, nötig");
  await expect(page.locator("main [lang=en]")).toHaveText(["c03 cuts it", "<b>new</b>"]);
  await page.getByRole("button", { name: "English" }).click();
  await expect(page.locator("main")).toContainText("the object's outline is blurred: c00 (3.0 px), c02 (2.1 px), 2 more");
  await expect(page.getByRole("cell", { name: "1.00 mm" })).toBeVisible();
  // Nothing is said twice, and codes are for programs.
  await expect(page.locator("[data-code=no_depth_camera]")).toHaveText("No depth camera took part in the capture: every hollow is filled.");
  await expect(page.locator("[data-code=blurred]")).toHaveText("the object's outline is blurred: c00 (3.0 px), c02 (2.1 px), 2 more");
});

/** What a camera says, the same on the German page, and what of that stays English. */
const TOLD = [
  [
    "no camera answered at 10.0.1.4 (timed out): check its power, cable and address",
    "unter 10.0.1.4 antwortet keine Kamera (die Zeit ist abgelaufen): prüfen Sie Strom, Kabel und Adresse", // German
    [],
  ],
  ["/dev/video2: No such device (os error 19)", "/dev/video2: dieses Gerät gibt es nicht (Fehler 19)", []], // German
  [
    "cannot open the device: Permission denied (os error 13)",
    "cannot open the device: das Recht dazu fehlt (Fehler 13)", // German
    ["cannot open the device:"],
  ],
  [
    "it could not be written: cannot write /r/a.mcap: No space left on device (os error 28): the disk is full: free some space there, and try again",
    "sie ließ sich nicht speichern: /r/a.mcap: Schreiben nicht möglich: auf dem Datenträger ist kein Platz mehr (Fehler 28): die Platte ist voll: schaffen Sie dort Platz, und versuchen Sie es wieder", // German
    [],
  ],
  ["/dev/video3: Numerical result out of range (os error 34)", "/dev/video3: Numerical result out of range (os error 34)", ["Numerical result out of range (os error 34)"]],
];

test("what the operating system says is in the page's language by its kind, and what is unusual stays as it was told", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const cameras = Object.fromEntries(TOLD.map(([words], n) => [`c0${n}`, { kind: "color", state: "away", words }]));
  await page.route("**/api/state", (route) => route.fulfill({ json: { status: { cameras }, age_ms: 5 } }));
  await page.getByRole("link", { name: "State" }).click();
  const words = page.locator(".cameras .card > p");
  await expect(words).toHaveText(TOLD.map(([told]) => told));
  await inGerman(page, async () => {
    await expect(words).toHaveText(TOLD.map(([, german]) => german));
    for (const [n, [, , english]] of TOLD.entries()) {
      const marked = words.nth(n).locator("[lang=en]");
      await expect(marked).toHaveCount(english.length);
      for (const [place, text] of english.entries()) await expect(marked.nth(place)).toHaveText(text);
    }
  });
});
