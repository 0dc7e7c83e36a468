// The state of the rig, and what is to be done about it.
import { readFileSync, writeFileSync } from "node:fs";
import { enter, expect, inGerman, test } from "./fixtures.mjs";

test("the state tells each camera's settings as read back, the disk, the models that wait and the ages", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  await page.getByRole("link", { name: "State" }).click();
  const cards = page.locator(".cameras .card");
  await expect(cards).toHaveCount(rig.options.cameras);
  await expect(cards.first()).toContainText("c00: ready");
  await cards.first().getByText("Settings as read back").click();
  await expect(cards.first().locator("dl")).toContainText("TriggerSource");
  await expect(cards.first().locator("dl")).toContainText("Software");
  const main = page.locator("main");
  await expect(main).toContainText(/Room for \d+ captures/);
  await expect(main).toContainText(/Models to be made: \d+/);
  await expect(main).toContainText(/Background pictures: \d+ (s|min) old \(old from 36 h on; new ones/);
});

test("from when on background pictures are old is told as the daemon is configured, also after a reload", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const facts = page.locator(".facts");
  await expect(facts).toContainText("(old from 36 h on; new ones whenever the light changed)");
  const file = rig.path("rig.toml");
  const before = readFileSync(file, "utf8");
  const reload = (text) => {
    writeFileSync(file, text);
    rig.children.get("daemon").kill("SIGHUP");
  };
  try {
    reload(before.replace("[verdict.background_age_h]\namber = 36.0", "[verdict.background_age_h]\namber = 7.5\nred = 48.0"));
    await expect(facts).toContainText("(old from 7.5 h on; new ones");
    await inGerman(page, () => expect(facts).toContainText("(alt ab 7,5 h; neue")); // German
  } finally {
    reload(before);
  }
  await expect(facts).toContainText("(old from 36 h on; new ones");
});

test("what is old by the daemon's limit is to be done, and a daemon that tells no limit has the usual one", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const models = { waiting: 0, running: [], expected_s: null };
  const status = { cameras: {}, plates_age_h: 9, calibration_age_h: 1, models };
  await page.route("**/api/state", (route) => route.fulfill({ json: { status, age_ms: 5 } }));
  await page.getByRole("link", { name: "State" }).click();
  const main = page.locator("main");
  await expect(main).toContainText("(old from 24 h on, unless configured otherwise; new ones");
  await expect(main).toContainText("Nothing is wrong.");
  models.settings = { "verdict.background_age_h": { amber: 8.0 } };
  await expect(main).toContainText("(old from 8 h on; new ones");
  await expect(main).toContainText("The background pictures are 9 h old, and models have that as a reason: take new ones.");
  models.settings = { "verdict.background_age_h": { amber: null } };
  await expect(main).toContainText("(no age is too high, as the rig is configured; new ones");
  await expect(main).toContainText("Nothing is wrong.");
  // Where no models are made, none has reasons.
  status.models = null;
  await expect(main).toContainText("9 h old (new ones whenever the light changed)");
});

test("what to do is what is wrong now, as `scand check` judges it, in the page's language", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const ready = { kind: "color", state: "ready", words: "Maker M1, serial 42, firmware 1.2, at 10.0.1.3", lost_frames: 0 };
  const clock = (words) => ["PTP", words];
  const c00 = {
    ...ready,
    health: [["temperature", "31.2 °C"], clock("Slave, 120 ns from its master")],
    // How its clock was when it was opened, and a value that the camera rounded.
    remarks: ["PTP: Listening, expected Slave or Master"],
    settings: [["ExposureTime", "8000", "7998.5"]],
  };
  const kinect = { ...ready, kind: "depth", words: "Kinect, serial number 7, usb", remarks: ["a raw reading counts millimetres"] };
  const status = { cameras: { c00, kinect }, capture_bytes: 1, captures_left: 500, plates_age_h: 1, calibration_age_h: 1 };
  status.models = { waiting: 2, running: [{ capture: "a-0001", seconds: 3 }], expected_s: 95 };
  await page.route("**/api/state", (route) => route.fulfill({ json: { status, age_ms: 5 } }));
  await page.getByRole("link", { name: "State" }).click();
  const main = page.locator("main");
  await expect(main).toContainText("Nothing is wrong.");
  await expect(main).toContainText("temperature 31.2 °C · PTP: Slave, 120 ns from its master");
  await expect(main).toContainText("Models to be made: 3, done in about 2 min");
  await expect(main).not.toContainText("Listening");
  await inGerman(page, async () => {
    await expect(main).toContainText("Alles in Ordnung.");
    await expect(main).toContainText("Temperatur 31.2 °C · PTP: Slave, 120 ns Abstand von der führenden Uhr"); // German
    await expect(main).toContainText("Seriennummer 42");
    await expect(main).toContainText("ein roher Messwert zählt Millimeter"); // German
    await expect(main.locator("[lang=en]")).toHaveCount(0);
  });
  c00.health = [clock("the clock is 900000 ns from its master, expected at most 100000 ns")];
  kinect.lost_frames = 7;
  // A clock of which only a remark tells.
  status.cameras.c01 = { ...ready, remarks: ["PTP: Listening, expected Slave or Master", "its lens is warm"] };
  status.cameras.c02 = { ...ready, state: "opening", words: "" };
  status.plates_age_h = 13;
  const todo = main.locator("section.card").first().locator("li");
  await expect(todo).toHaveText([
    /^c00: PTP: the clock is 900000 ns .* Run a PTP master/,
    /^kinect lost frames since the daemon started \(7\): check its link/,
    /^c01: PTP: Listening, expected Slave or Master\. Run a PTP master/,
    /^c01: its lens is warm$/,
    /^c02 is being opened: wait a moment\.$/,
    /^The background pictures are 13 h old/,
  ]);
  await inGerman(page, async () => {
    await expect(todo.first()).toContainText("erlaubt sind 100000 ns. Lassen Sie im Netz der Kameras"); // German
    await expect(todo.locator("[lang=en]")).toHaveText(["its lens is warm"]);
  });
  status.captures_left = 1;
  await expect(todo.last()).toHaveText(/^Only 1 capture fits on the disk: /);
  await expect(main).toContainText("Room for 1 capture");
  await expect(main).not.toContainText("Room for 1 captures");
});
