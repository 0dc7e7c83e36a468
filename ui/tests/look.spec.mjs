// The live pictures of the cameras, for setting up.
import { enter, expect, inGerman, shot, sign, taken, test } from "./fixtures.mjs";
import { READINGS_PERCENT, until } from "./rig.mjs";

test("a look shows every camera with its outline, is not recorded, and ends by itself", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const before = taken(rig);
  await page.getByRole("link", { name: "Look" }).click();
  const cards = page.locator(".looks .look");
  await expect(cards).toHaveCount(rig.options.cameras);
  for (const card of await cards.all()) {
    await expect(card.locator("img")).toHaveJSProperty("naturalWidth", 320);
    await expect(card).toContainText("Clipped highlights: ");
    await expect(card).toContainText("The object is within the frame");
    await expect(card).toContainText(/Sharpness \d+/);
    await expect(card.locator("path.outline")).toHaveAttribute("d", /^M\d+ \d+L/);
    await expect(card).toContainText(/\d\.\d s old/);
  }
  const source = () => cards.first().locator("img").getAttribute("src");
  const first = await source();
  await expect.poll(source).not.toBe(first);
  // The last one is below the others; made large, all of its picture is on the screen.
  const last = cards.last();
  await last.getByRole("button", { name: "Large" }).click();
  await expect(last.getByRole("button", { name: "Large" })).toHaveAttribute("aria-pressed", "true");
  await expect(last.locator(".picture")).toBeInViewport({ ratio: 0.99 });
  await shot(page, "look");
  // A press comes between the pictures.
  const pressed = JSON.parse(rig.scand("trigger", "--socket", "scand.sock", "--until", "captured", "--json").trim().split("\n").pop());
  expect(pressed.type).toBe("captured");
  await expect.poll(() => taken(rig)).toBe(before + 1);
  await page.getByRole("link", { name: "Now" }).click();
  await until("the end of the look", () => rig.status().looking === 0, 20);
});

test("a look says why there is no outline and no picture", async ({ page, rig }) => {
  test.setTimeout(150_000);
  await rig.prepare();
  await enter(page, rig, "viewer");
  await rig.show("background");
  await page.getByRole("link", { name: "Look" }).click();
  const cards = page.locator(".looks .look");
  await expect(cards).toHaveCount(rig.options.cameras);
  await expect(cards.first()).toContainText("no object is found");
  await rig.stop("cameras", "SIGKILL");
  await expect(cards.first()).toContainText("No picture: ", { timeout: 40_000 });
  await expect(cards.first().locator("img")).toHaveCount(0);
  await rig.startCamerasAgain();
  await expect(cards.first().locator("img")).toHaveJSProperty("naturalWidth", 320, { timeout: 40_000 });
  await until("every camera is ready", () => Object.values(rig.status().cameras).every((camera) => camera.state === "ready"));
});

test("a look ends with the daemon, and goes on with a full disk, the depth camera among the others", async ({ page, rig }) => {
  test.setTimeout(180_000);
  await rig.prepare();
  await enter(page, rig, "viewer");
  await page.getByRole("link", { name: "Look" }).click();
  const cards = page.locator(".looks .look");
  await expect(cards).toHaveCount(rig.options.cameras);
  await rig.stop("daemon");
  const alert = page.getByRole("alert");
  await expect(alert).toContainText("There are no pictures: the daemon does not answer");
  await expect(cards).toHaveCount(0);
  await inGerman(page, () => expect(alert).toContainText(/Es gibt keine Bilder: der Dienst antwortet nicht: (diese Datei|die Verbindung|die Gegenseite|die Daten)/)); // German
  try {
    Object.assign(rig.options, { keepFree: 900_000_000, depth: true });
    await rig.startDaemon();
    await expect(cards).toHaveCount(rig.options.cameras + 1);
    await expect(cards.first().locator("img")).toHaveJSProperty("naturalWidth", 320);
    const depth = page.locator(".look[data-camera=kinect]");
    await expect(depth).toContainText(`Pixels with a reading: ${READINGS_PERCENT} %`);
    await expect(depth).toContainText(/\d\.\d s old/);
    await expect(depth.locator("img")).toHaveJSProperty("naturalWidth", 160);
    await expect(depth.locator("path.outline")).toHaveCount(0);
    const source = () => depth.locator("img").getAttribute("src");
    const first = await source();
    await expect.poll(source).not.toBe(first);
    await page.getByRole("link", { name: "Now" }).click();
    await sign(page, "disk_full");
    await expect(page.locator(".now h1")).toHaveText("The disk is full");
  } finally {
    await rig.stop("daemon");
    Object.assign(rig.options, { keepFree: undefined, depth: undefined });
    await rig.startDaemon();
  }
});

test("a picture is old only if it is older than the cameras' turns make it", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const seen = { width: 320, height: 240, scale: 8 };
  const picture = await page.evaluate(() => document.createElement("canvas").toDataURL("image/jpeg").split(",")[1]);
  const look = (age_ms) => ({ age_ms, picture, seen, words: null });
  const eleven = (age_ms) => Object.fromEntries(Array.from({ length: 11 }, (_, n) => [`c${n}`, look(age_ms)]));
  let cameras = eleven(7600);
  let [number, isSilent] = [0, false];
  await page.route(/\/api\/look\?/, async (route) => {
    await new Promise((done) => setTimeout(done, 300));
    if (isSilent) return;
    await route.fulfill({ json: { number: ++number, problem: null, cameras, good: {} } }).catch(() => {});
  });
  await page.getByRole("link", { name: "Look" }).click();
  await expect(page.locator(".look p.quiet")).toHaveCount(11);
  await expect(page.locator(".look p.warning")).toHaveCount(0);
  cameras = eleven(20_000);
  await expect(page.locator(".look p.warning")).toHaveCount(11);
  // A tablet that slept, whose monotonic clock stood still, shows none when it wakes.
  isSilent = true;
  await page.waitForTimeout(500);
  await page.evaluate(() => {
    const now = Date.now.bind(Date);
    Date.now = () => now() + 3_600_000;
  });
  await expect(page.locator(".look")).toHaveCount(0, { timeout: 5000 });
});

test("a look tells what is wrong with a picture, how old it is, and why there is none", async ({ page, rig }) => {
  await enter(page, rig, "viewer");
  const picture = await page.evaluate(() => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [320, 240];
    return canvas.toDataURL("image/jpeg").split(",")[1];
  });
  const square = [[10, 10], [60, 10], [60, 60], [10, 60]];
  const size = { width: 320, height: 240, scale: 8 };
  const light = { clipped_ppm: 30_000, clipped: [square], sharpness_percent: 40 };
  const away = "no camera answered at 10.0.1.4 (timed out): check its power, cable and address";
  const cameras = {
    c00: { age_ms: 6000, picture, seen: { ...size, ...light, outline: [square], touches: ["left", "bottom"] }, words: null },
    c01: { age_ms: 100, picture: null, seen: null, words: away },
    kinect: { age_ms: 100, picture, seen: { ...size, readings_percent: 83 }, words: null },
  };
  let number = 0;
  await page.route(/\/api\/look\?/, async (route) => {
    // As often as the daemon has new ones; the page may be gone by then.
    await new Promise((done) => setTimeout(done, 500));
    await route.fulfill({ json: { number: ++number, problem: null, cameras, good: { c00: 80 } } }).catch(() => {});
  });
  await page.getByRole("link", { name: "Look" }).click();
  const [colour, missing, depth] = ["c00", "c01", "kinect"].map((camera) => page.locator(`.look[data-camera=${camera}]`));
  await expect(colour.locator("img")).toHaveJSProperty("naturalWidth", 320);
  await expect(colour).toContainText("The object touches the frame: left, bottom");
  await expect(colour).toContainText("Clipped highlights: 3 %");
  await expect(colour).toContainText("Sharpness 40; 80 in the last good capture");
  await expect(colour.locator("li.warning")).toHaveCount(3);
  await expect(colour.locator("path.clipped")).toHaveAttribute("d", "M10 10L60 10L60 60L10 60Z");
  await expect(colour.locator("path.clipped")).toHaveAttribute("fill", "url(#hatch)");
  await expect(colour.locator("p.warning")).toContainText(/[67]\.\d s old/);
  await expect(depth).toContainText("Pixels with a reading: 83 %");
  await expect(depth.locator(".warning")).toHaveCount(0);
  await expect(missing).toContainText(`No picture: ${away}`);
  await inGerman(page, () => expect(missing).toContainText("Kein Bild: unter 10.0.1.4 antwortet keine Kamera")); // German
});
