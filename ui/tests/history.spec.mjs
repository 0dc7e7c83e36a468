// What was scanned: captures, their models in the viewer, photographs, comparisons and downloads.
import { readFileSync, readdirSync, rmSync, statSync } from "node:fs";
import { enter, expect, inGerman, make, shot, test } from "./fixtures.mjs";

test("a small form of the model and of the preview is made once, and is what browsers load", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const logged = rig.log("page").length;
  const [recording, capture] = make(rig);
  const loaded = page.waitForResponse((answer) => answer.url().endsWith("view.glb"));
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  const headers = (await loaded).headers();
  expect(headers["content-encoding"]).toBe("gzip");
  const whole = statSync(rig.path(`models/${recording}/${capture}/model.glb`)).size;
  expect(Number(headers["content-length"])).toBeLessThan(whole / 2);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}`);
  const picture = page.locator(".strip img").last();
  await picture.scrollIntoViewIfNeeded();
  await expect.poll(() => picture.evaluate((img) => [img.complete, img.naturalWidth].join())).toMatch(/^true,[1-9]/);
  const width = await picture.evaluate((img) => img.naturalWidth);
  expect(width).toBeLessThanOrEqual(480);
  const views = readdirSync(rig.path("page-cache")).length;
  expect(views).toBeGreaterThan(1);
  await page.reload();
  await expect.poll(() => picture.evaluate((img) => img.complete)).toBe(true);
  expect(readdirSync(rig.path("page-cache")).length).toBe(views);
  // The cache may be emptied at any time: what is asked for is made again.
  for (const name of readdirSync(rig.path("page-cache"))) rmSync(rig.path(`page-cache/${name}`));
  const again = await page.request.get(`http://127.0.0.1:${rig.port}${new URL((await loaded).url()).pathname}`);
  expect(again.status()).toBe(200);
  expect(Number(again.headers()["content-length"])).toBeLessThan(whole / 2);
  expect(readdirSync(rig.path("page-cache")).length).toBeGreaterThan(0);
  expect(rig.log("page").slice(logged)).not.toContain("for browsers");
});

test("photographs stand beside the model, and one that is chosen is shown large", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const logged = rig.log("page").length;
  const [recording, capture] = make(rig);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  const small = page.locator(".photographs button");
  await expect(small).toHaveCount(rig.options.cameras);
  for (const photograph of await small.all()) {
    await expect(photograph.locator("img")).toHaveJSProperty("naturalWidth", 320);
  }
  await expect(page.getByRole("dialog")).toHaveCount(0);
  await page.getByRole("button", { name: "Enlarge the photograph of c02" }).click();
  const large = page.getByRole("dialog", { name: `Photograph of c02 in ${capture}` });
  await expect(large.locator("img")).toHaveJSProperty("naturalWidth", 320);
  await shot(page, "photograph");
  await page.keyboard.press("Escape");
  await expect(large).toHaveCount(0);
  // One that is opened right after another was closed stays open.
  await page.evaluate(() => {
    const [first, second] = document.querySelectorAll(".photographs button");
    const dialog = document.querySelector("scand-photographs dialog");
    first.click();
    return new Promise((done) => setTimeout(() => (dialog.close(), second.click(), done()), 300));
  });
  await expect(page.getByRole("dialog")).toHaveCount(1);
  await page.waitForTimeout(300);
  await page.getByRole("button", { name: "Close" }).click();
  await expect(page.getByRole("dialog")).toHaveCount(0);
  await small.first().focus();
  await page.keyboard.press("Enter");
  await page.getByRole("button", { name: "Close" }).click();
  await expect(page.getByRole("dialog")).toHaveCount(0);
  expect(rig.log("page").slice(logged)).not.toContain("cannot make its photographs");
});

/** Makes a model and opens it, as one who may only look; the canvas that shows it. */
async function openModel(page, rig) {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const [recording, capture] = make(rig);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  const canvas = page.locator("canvas[data-loaded]");
  await expect(canvas).toBeVisible();
  return canvas;
}

test("the wheel scrolls the page over a model, and zooms with Ctrl or after a click; its buttons are seen with it", async ({ page, rig }) => {
  const canvas = await openModel(page, rig);
  await expect(canvas).toHaveAttribute("data-zoom", "1.00");
  await expect(page.locator(".photographs img")).toHaveCount(rig.options.cameras);
  const box = await canvas.boundingBox();
  expect(box.height).toBeLessThanOrEqual(768 * 0.55);
  await expect(page.locator("[data-mode=textured]")).toBeInViewport({ ratio: 1 });
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const scrolled = () => page.evaluate(() => scrollY);
  await page.mouse.move(x, y);
  await page.mouse.wheel(0, 100);
  await expect.poll(scrolled).toBe(100);
  await expect(canvas).toHaveAttribute("data-zoom", "1.00");
  await page.evaluate(() => scrollTo(0, 0));
  await page.keyboard.down("Control");
  await page.mouse.wheel(0, -100);
  await page.keyboard.up("Control");
  await expect(canvas).not.toHaveAttribute("data-zoom", "1.00");
  const reset = page.getByRole("button", { name: "Reset the view" });
  await reset.click();
  await expect(canvas).toHaveAttribute("data-zoom", "1.00");
  // After a click the wheel alone zooms, until the pointer leaves the picture.
  await page.evaluate(() => scrollTo(0, 0));
  await page.mouse.click(x, y);
  await page.mouse.wheel(0, -100);
  await expect(canvas).not.toHaveAttribute("data-zoom", "1.00");
  expect(await scrolled()).toBe(0);
  await reset.click();
  await page.getByRole("button", { name: "Zoom in" }).click();
  await expect(canvas).toHaveAttribute("data-zoom", "1.18");
  await page.evaluate(() => scrollTo(0, 0));
  await page.mouse.move(x, y);
  await page.mouse.wheel(0, 100);
  await expect.poll(scrolled).toBe(100);
  await expect(canvas).toHaveAttribute("data-zoom", "1.18");
});

test("measuring shows that it is on, and says when a tap is beside the object", async ({ page, rig }) => {
  await openModel(page, rig);
  const button = page.locator("[data-measure]");
  const told = page.locator(".viewer [role=status]");
  await button.scrollIntoViewIfNeeded();
  const before = await button.boundingBox();
  await expect(button).toHaveAttribute("aria-pressed", "false");
  await button.click();
  await expect(button).toHaveAttribute("aria-pressed", "true");
  await expect(told).toContainText("Tap the first point.");
  expect(await button.boundingBox()).toEqual(before);
  const box = await page.locator("canvas").boundingBox();
  const tap = (x, y) => page.mouse.click(box.x + x, box.y + y);
  await tap(15, 15);
  await expect(told).toHaveText("That was beside the object: tap a point on it.");
  await expect(button).toHaveAttribute("aria-pressed", "true");
  await tap(box.width / 2 - 10, box.height / 2);
  await expect(told).toHaveText("Tap the second point.");
  await tap(box.width / 2 + 10, box.height / 2);
  await expect(told).toHaveText(/^\d+\.\d mm between/);
  await expect(button).toHaveAttribute("aria-pressed", "false");
  await shot(page, "measured");
  await button.click();
  await button.click();
  await expect(button).toHaveAttribute("aria-pressed", "false");
  await expect(told).toHaveText("");
});

/** Opens a model and measures between two points of it, 80 pixels apart; the middle between them on the screen, and how
 * far they are apart in mm. */
async function measureAcross(page, rig, tap) {
  const canvas = await openModel(page, rig);
  await expect(page.locator(".photographs img")).toHaveCount(rig.options.cameras);
  await page.locator("[data-measure]").click();
  const box = await canvas.boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const told = page.locator(".viewer [role=status]");
  await tap(x - 40, y);
  await expect(told).toHaveText("Tap the second point.");
  await tap(x + 40, y);
  await expect(told).toHaveText(/^\d+\.\d mm between the two points\. Drag one of them to move it\.$/);
  return { x, y, distance: async () => parseFloat(await told.textContent()) };
}

test("a measured point is dragged to another place of the model, which does not turn meanwhile", async ({ page, rig }) => {
  const { x, y, distance } = await measureAcross(page, rig, (x, y) => page.mouse.click(x, y));
  const first = await distance();
  const drag = async (from, to) => {
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(...to, { steps: 8 });
    await page.mouse.up();
  };
  await drag([x + 40, y], [x, y]);
  await expect.poll(distance).toBeLessThan(0.8 * first);
  await shot(page, "moved");
  // Back where it was it has the same distance, because the model is seen as before.
  await drag([x, y], [x + 40, y]);
  await expect.poll(distance).toBeCloseTo(first, 1);
  // Beside the object it stays where it was last.
  await drag([x + 40, y], [x + 40, y - 180]);
  const before = await distance();
  expect(before).toBeGreaterThan(0);
  const canvas = page.locator("canvas");
  await page.mouse.move(x - 40, y);
  await expect(canvas).toHaveCSS("cursor", "grab");
  // Somewhere else, a drag turns the model, and the distance stays.
  await drag([x - 40, y + 60], [x + 60, y + 60]);
  expect(await distance()).toBe(before);
  await page.mouse.move(x - 40, y);
  await expect(canvas).toHaveCSS("cursor", "auto");
  await page.locator("[data-measure]").click();
  await expect(page.locator("[data-measure]")).toHaveAttribute("aria-pressed", "true");
});

test("the keyboard alone measures, from the middle of the picture", async ({ page, rig }) => {
  const canvas = await openModel(page, rig);
  await expect(canvas).toHaveAccessibleName(/Enter takes the point in the middle of the picture/);
  const told = page.locator(".viewer [role=status]");
  await page.locator("[data-measure]").focus();
  await page.keyboard.press("Enter");
  await expect(told).toContainText("Tap the first point.");
  await canvas.focus();
  await page.keyboard.press("Enter");
  await expect(told).toHaveText("Tap the second point.");
  for (let n = 0; n < 2; n++) await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Enter");
  await expect(told).toHaveText(/^\d+\.\d mm between/);
  // Not the same point twice.
  expect(parseFloat(await told.textContent())).toBeGreaterThan(1);
  await expect(page.locator("[data-measure]")).toHaveAttribute("aria-pressed", "false");
  // With Ctrl, a key is the browser's.
  const isLeft = (shown) => shown.dispatchEvent(new KeyboardEvent("keydown", { key: "+", ctrlKey: true, cancelable: true }));
  expect(await canvas.evaluate(isLeft)).toBe(true);
  await expect(canvas).toHaveAttribute("data-zoom", "1.00");
});

test("a model is drawn again when the browser took the graphics away and gave them back", async ({ page, rig, expected }) => {
  expected.push("CONTEXT_LOST");
  const canvas = await openModel(page, rig);
  const drawn = await canvas.evaluate(async (shown) => {
    const context = shown.getContext("webgl2");
    const graphics = context.getExtension("WEBGL_lose_context");
    const heard = (name) => new Promise((done) => shown.addEventListener(name, () => setTimeout(done, 100), { once: true }));
    const lost = heard("webglcontextlost");
    graphics.loseContext();
    await lost;
    let draws = 0;
    for (const name of ["drawElements", "drawArrays"]) {
      const draw = context[name];
      context[name] = (...how) => {
        draws++;
        draw.apply(context, how);
      };
    }
    const restored = heard("webglcontextrestored");
    graphics.restoreContext();
    await restored;
    for (let n = 0; n < 50 && draws === 0; n++) await new Promise((done) => setTimeout(done, 100));
    return draws;
  });
  expect(drawn).toBeGreaterThan(0);
});

test.describe("with a finger", () => {
  test.use({ hasTouch: true });
  test("a measured point is dragged, and the page does not scroll meanwhile", async ({ page, rig }) => {
    const { x, y, distance } = await measureAcross(page, rig, (x, y) => page.touchscreen.tap(x, y));
    const first = await distance();
    // Over a model that was not tapped last, a finger that moves up or down scrolls the page.
    const canvas = page.locator("canvas");
    await canvas.evaluate((shown) => {
      shown.focus();
      shown.blur();
    });
    await expect(canvas).toHaveCSS("touch-action", "pan-y");
    const before = await page.evaluate(() => scrollY);
    const session = await page.context().newCDPSession(page);
    const touch = (type, ...touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
    await touch("touchStart", { x: x + 50, y: y + 5 });
    // Up first, as where the page would scroll, and then across the object.
    for (let n = 1; n <= 4; n++) await touch("touchMove", { x: x + 50, y: y + 5 - 5 * n });
    for (let n = 1; n <= 8; n++) await touch("touchMove", { x: x + 50 - 5 * n, y: y - 15 });
    await touch("touchEnd");
    await expect.poll(distance).toBeLessThan(0.8 * first);
    expect(await page.evaluate(() => scrollY)).toBe(before);
  });
});

test("the scale of the expected errors leaves out the few largest ones, and says so", async ({ page, rig }) => {
  await openModel(page, rig);
  await page.locator("[data-mode=error]").click();
  const shades = page.locator(".legend li");
  await expect(shades).toHaveCount(5);
  await expect(shades.first()).toHaveText("0.00");
  await expect(shades.last()).toHaveText(/^\s*\d+\.\d\d and more\s*$/);
  await page.locator("[data-mode=provenance]").click();
  await expect(shades.filter({ hasText: "and more" })).toHaveCount(0);
  // The words for where a surface comes from are those of the preview (docs/results.md), here and in the table.
  const words = ["silhouettes", "carved by depth", "measured by depth", "interpolated", "a guess", "on the table"];
  await expect(shades).toHaveText(words);
  const rows = page.locator("dl + table tbody th");
  await expect(rows.first()).toBeVisible();
  const parts = await rows.allTextContents();
  expect(parts).toContain("silhouettes");
  expect(words).toEqual(expect.arrayContaining(parts));
  await inGerman(page, () => expect(shades.nth(4)).toHaveText("geraten")); // German
});

/** The files that a capture's page offers, in its order, and their media types. */
const DOWNLOADS = {
  "model.glb": "model/gltf-binary",
  "model.ply": "application/octet-stream",
  "preview.png": "image/png",
  "report.json": "application/json",
};

test("each file that is offered is downloaded as it is, under its capture's name, and may do nothing as a page", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const [recording, capture] = make(rig);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  const links = page.locator(".files a");
  await expect(links).toHaveText(Object.keys(DOWNLOADS));
  for (const [name, type] of Object.entries(DOWNLOADS)) {
    const link = page.getByRole("link", { name, exact: true });
    const begun = page.waitForEvent("download");
    await link.click();
    const download = await begun;
    expect(download.suggestedFilename()).toBe(`${capture}.${name}`);
    const bytes = readFileSync(rig.path(`models/${recording}/${capture}/${name}`));
    expect(readFileSync(await download.path()).equals(bytes), `${name} as it was stored`).toBe(true);
    const answer = await page.request.get(await link.evaluate((target) => target.href));
    const headers = answer.headers();
    expect(headers["content-type"], name).toBe(type);
    expect(headers["content-disposition"], name).toBe(`attachment; filename="${capture}.${name}"`);
    expect(headers["content-security-policy"], name).toContain("sandbox");
    expect(headers["x-content-type-options"], name).toBe("nosniff");
    expect((await answer.body()).equals(bytes), `${name} as it was sent`).toBe(true);
  }
});

test("a model is compared with one of the same object in an earlier session", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const object = `1911.${Date.now()}`;
  const scan = async (session) => {
    rig.scand("session", "start", session, "--socket", "scand.sock");
    const lines = rig.scand("trigger", "--socket", "scand.sock", "--subject", object, "--until", "done", "--json");
    rig.scand("session", "close", "--socket", "scand.sock");
    return JSON.parse(lines.trim().split("\n").pop()).model.split("/").slice(-2);
  };
  const earlier = await scan("earlier");
  const later = await scan("later");
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${later.join("/")}`);
  const list = page.getByLabel("Compare with another model");
  await expect(list.locator("optgroup option")).toContainText([`${earlier.join(": ")}`]);
  await list.selectOption(earlier.join("/"));
  await expect(page.locator("[data-compared]")).toContainText("cm³");
  await expect(page.locator("[data-compared] tbody th")).toContainText(["Verdict", "Width", "Depth", "Height"]);
  // The mean is the report's, whose verdict stands beside it.
  const report = (made) => JSON.parse(readFileSync(rig.path(`models/${made.join("/")}/report.json`), "utf8"));
  const means = [later, earlier].map((made) => `${(1000 * report(made).model.mean_expected_error).toFixed(2)} mm`);
  const row = page.locator("[data-compared] tbody tr").filter({ hasText: "Mean expected error" });
  await expect(row.locator("td")).toContainText(means);
  const pills = page.locator("[data-compared] .verdict");
  await expect(pills).toHaveCount(2);
  for (const pill of await pills.all()) expect((await pill.boundingBox()).height).toBeLessThan(40);
  await expect(page.locator(".photographs img")).toHaveCount(rig.options.cameras);
  const downloads = page.getByRole("heading", { name: "Downloads" });
  const before = await downloads.evaluate((heading) => heading.offsetTop);
  await expect(page.locator("dt").first()).toHaveText("Width × depth × height, as it lay");
  await expect(page.locator("scand-compare")).toContainText("Surfaces are compared as they lay in the rig");
  await page.locator("[data-measure-surfaces]").click();
  await expect(page.locator("[data-apart]")).toContainText(/\d\.\d\d/, { timeout: 60_000 });
  expect(await downloads.evaluate((heading) => heading.offsetTop)).toBe(before);
  await page.getByRole("button", { name: "Enlarge the picture of the distances" }).click();
  const large = page.getByRole("dialog", { name: /^Both models/ });
  const widths = await large.locator("img").evaluate((img) => [img.width, img.naturalWidth]);
  expect(widths[0]).toBe(widths[1]);
  await large.getByRole("button", { name: "Close" }).click();
  await expect(large).toHaveCount(0);
  await page.locator("[data-compared] thead a").click();
  await expect(page.locator("h1")).toHaveText(earlier[1]);
  // In the history, an earlier session is chosen from the list.
  await page.evaluate((hash) => (location.hash = hash), `#/history/${later[0]}`);
  const sessions = page.locator("#recording");
  await expect(sessions).toHaveValue(later[0]);
  await sessions.selectOption(earlier[0]);
  await expect(page.getByRole("heading", { name: `Captures of ${earlier[0]}` })).toBeVisible();
  await expect(page.locator(".strip li").filter({ hasText: earlier[1] })).toHaveCount(1);
  await expect(page.locator(".strip li").filter({ hasText: later[1] })).toHaveCount(0);
  await page.goBack();
  await expect(page.getByRole("heading", { name: `Captures of ${later[0]}` })).toBeVisible();
  await expect(sessions).toHaveValue(later[0]);
});

test("captures of today are in the history after the daemon and the page were started again", async ({ page, rig }) => {
  await rig.prepare();
  const [recording, first] = make(rig);
  await rig.stop("daemon");
  await rig.stop("page");
  await rig.startDaemon();
  await rig.startPage();
  await enter(page, rig, "viewer");
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}`);
  const card = page.locator(".strip li").filter({ hasText: first });
  await expect(card.locator("img")).toHaveCount(1);
  await expect(card.locator(".verdict")).toContainText(/Green|Amber|Red/);
  // What was taken after that stands beside it.
  const [again, second] = make(rig);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${again}`);
  await expect(page.locator(".strip li").filter({ hasText: second })).toHaveCount(1);
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${first}`);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
});

test("what is shown of a model belongs to the capture that is shown", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await rig.prepare();
  await enter(page, rig);
  const [[recording, first], [, second]] = [make(rig), make(rig)];
  const open = (name) => page.evaluate((hash) => (location.hash = hash), `#/history/${recording}/${name}`);
  await open(first);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await page.locator("[data-mode=error]").click();
  await page.locator("[data-measure]").click();
  await page.getByLabel("Compare with another model").selectOption(second);
  await page.locator("[data-compared] thead a").click();
  await expect(page.locator("h1")).toHaveText(second);
  await expect(page.getByLabel("Compare with another model")).toHaveValue("");
  await expect(page.locator("[data-compared]")).toHaveCount(0);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await expect(page.locator(".viewer [role=status]")).toHaveText("");
  await expect(page.locator(".legend li")).toHaveCount(5);
  // A model that is not shown any more is not waited for, and says nothing of the one that is shown by then.
  let release;
  const held = new Promise((done) => (release = done));
  await page.route(`**/${first}/view.glb`, async (route) => {
    await held;
    await route.abort().catch(() => {});
  });
  const asked = page.waitForRequest(`**/${first}/view.glb`);
  await open(first);
  await asked;
  const left = page.waitForEvent("requestfailed", (request) => request.url().endsWith(`${first}/view.glb`));
  await open(second);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await left;
  release();
  await page.waitForTimeout(300);
  await expect(page.locator(".viewer [role=status]")).toHaveText("");
  await page.unroute(`**/${first}/view.glb`);
  // A capture that cannot be asked for has nobody else's verdict.
  await page.route(`**/api/recordings/${recording}`, (route) => route.abort());
  await open(first);
  await expect(page.getByRole("alert")).toContainText("does not answer");
  await expect(page.locator("main .verdict")).toHaveCount(0);
});
