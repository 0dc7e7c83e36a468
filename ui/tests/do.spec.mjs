// What an operator does at the rig: background pictures, sessions, presses, the number of an object, decisions, notes.
import { readdirSync } from "node:fs";
import { closeSession, enter, expect, make, shot, sign, taken, test, watch } from "./fixtures.mjs";

test("background pictures, a session, a press with a scanned number, and the model in the viewer", async ({ page, rig }) => {
  await rig.show("background");
  await enter(page, rig);
  await closeSession(page);
  await sign(page, "ready");
  await shot(page, "ready");
  await page.getByRole("button", { name: "Take background pictures" }).click();
  // One camera's picture comes late, and for so long the rig is busy: the page itself looks, for on a slow machine that
  // may be over between two questions from here.
  await rig.tell("delay c00 1500");
  const waits = page.waitForFunction(() => {
    const words = document.querySelector("[data-sign=busy] h1")?.textContent ?? "";
    return words.trim() === "Please wait" && document.querySelector("button.press").disabled;
  });
  await page.getByRole("button", { name: "Yes, take them" }).click();
  await waits;
  await expect(page.locator(".do > .told")).toContainText("Done");
  await rig.tell("delay c00 0");
  await rig.show("captures");
  rig.isPrepared = true;
  const before = taken(rig);
  await page.getByLabel("Name of the session").fill("amphora");
  await page.getByLabel("Operator").fill("Ann");
  await page.getByRole("button", { name: "Begin the session" }).click();
  await expect(page.locator(".facts")).toContainText("Session amphora");
  // A scanner types the number and Enter, wherever the focus is; Enter takes no capture.
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.type("1884.3");
  await page.keyboard.press("Enter");
  await expect(page.getByLabel("Number of the object")).toHaveValue("1884.3");
  expect(taken(rig)).toBe(before);
  const lies = page.getByLabel("How it lies");
  await expect(lies).toHaveAttribute("placeholder", "such as: upside down");
  await expect(lies).toHaveAccessibleDescription(/If you turn it between captures/);
  await lies.fill("upside down");
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await sign(page, "capturing", "hands_may_move", "safe", "green", "amber");
  await sign(page, "green", "amber");
  await shot(page, "verdict");
  expect(taken(rig)).toBe(before + 1);
  await expect(page.locator(".facts")).toContainText("object 1884.3");
  await expect(page.getByLabel("How it lies")).toHaveValue("");
  await page.locator(".facts a").click();
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await expect(page.locator("dl")).toContainText("mm");
  await expect(page.locator("main")).toContainText("lies upside down");
  for (const mode of ["shaded", "provenance", "error", "textured"]) {
    await page.locator(`[data-mode=${mode}]`).click();
    await expect(page.locator(`[data-mode=${mode}]`)).toHaveAttribute("aria-pressed", "true");
  }
  await page.locator("canvas").focus();
  await page.keyboard.press("ArrowLeft");
  await shot(page, "capture");
  await page.locator("[data-measure]").click();
  const box = await page.locator("canvas").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  for (const [dx, dy] of [[-25, 10], [25, 10]]) {
    await page.mouse.click(x + dx, y + dy);
  }
  await expect(page.locator(".viewer [role=status]")).toContainText(/\d+\.\d mm between/);
});

test("a scanner's fast keys and Enter put a number into its field, whatever was tapped last, and press nothing", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const before = taken(rig);
  const number = page.locator("#number");
  const scan = async (text) => {
    await page.keyboard.type(text);
    await page.keyboard.press("Enter");
  };
  await page.evaluate(() => document.activeElement.blur());
  await scan("4006381333931");
  await expect(number).toHaveValue("4006381333931");
  // The next number takes the place of the last one.
  await scan("1884.3/b");
  await expect(number).toHaveValue("1884.3/b");
  // A button that was tapped has the focus, and Enter would be another tap.
  await page.getByRole("button", { name: "Deutsch" }).click();
  await scan("1911-7");
  await expect(page.locator("html")).toHaveAttribute("lang", "de");
  await expect(number).toHaveValue("1911-7");
  await page.getByRole("button", { name: "English" }).click();
  // What is typed into another field stays there.
  await page.getByLabel("How it lies").focus();
  await scan("upright");
  await expect(page.getByLabel("How it lies")).toHaveValue("upright");
  await expect(number).toHaveValue("1911-7");
  expect(taken(rig)).toBe(before);
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await expect(page.locator(".facts")).toContainText("object 1911-7");
  await expect.poll(() => taken(rig)).toBe(before + 1);
});

test("a press, or another order, while another tablet's press is being taken is answered in words", async ({ page, rig, browser }) => {
  await rig.prepare();
  await enter(page, rig);
  const other = await browser.newPage();
  const watched = watch(other);
  await enter(other, rig);
  const before = taken(rig);
  // One camera's picture comes late, and for so long the press is being taken.
  await rig.tell("delay c00 1500");
  // The other page presses by itself as soon as it shows the capture, which on a slow machine may be over by the time
  // that a click from here arrives.
  const both = other.waitForFunction(() => {
    if (!document.querySelector("[data-sign=capturing]")) return false;
    for (const selector of ["button.press", "[data-say=accept]"]) document.querySelector(selector).click();
    return true;
  });
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await both;
  const told = other.locator(".do > .told");
  await expect(told).toHaveText("Busy: the rig carries out another order, such as a capture. This press took no capture.");
  await expect(other.locator(".say .told")).toContainText("Refused: another order is being carried out");
  await expect(page.locator(".do > .told")).toContainText("safe on the disk");
  await rig.tell("delay c00 0");
  expect(taken(rig)).toBe(before + 1);
  // Then it is the other tablet's turn.
  await other.getByRole("button", { name: "Press", exact: true }).click();
  await expect(told).toContainText("safe on the disk");
  expect(taken(rig)).toBe(before + 2);
  expect(watched.errors).toEqual([]);
  await other.close();
});

test("a double tap, and a connection that breaks in the middle, take one capture each", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await enter(page, rig, "operator", rig.wirePort);
  const before = taken(rig);
  await page.getByRole("button", { name: "Press", exact: true }).dblclick();
  await expect(page.locator(".do > .told")).toContainText("safe on the disk");
  expect(taken(rig)).toBe(before + 1);
  await page.waitForTimeout(500);
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await page.waitForTimeout(150);
  rig.wire.cut();
  await page.waitForTimeout(1500);
  rig.wire.mend();
  await expect(page.locator(".do > .told")).toContainText("safe on the disk", { timeout: 30_000 });
  expect(taken(rig)).toBe(before + 2);
});

test("a page that is loaded again before the answer to its press came asks for that press, and takes no other capture", async ({ page, rig }) => {
  await enter(page, rig);
  const before = taken(rig);
  const told = page.locator(".do > .told");
  const pressed = page.waitForRequest("**/api/press");
  await page.getByRole("button", { name: "Press", exact: true }).click();
  const { press_id } = (await pressed).postDataJSON();
  await expect(told).toContainText("safe on the disk");
  const name = await told.textContent();
  // What the page keeps of a press until its answer is there.
  const kept = { id: press_id, subject: "", placement: "" };
  await page.evaluate((kept) => sessionStorage.setItem("scand-press", JSON.stringify({ ...kept, at: Date.now() })), kept);
  const again = page.waitForRequest("**/api/press");
  await page.reload();
  expect((await again).postDataJSON().press_id).toBe(press_id);
  await expect(told).toHaveText(name);
  expect(taken(rig)).toBe(before + 1);
  expect(await page.evaluate(() => sessionStorage.getItem("scand-press"))).toBe(null);
});

test("what is typed while a press is under way stays, and the answer takes nobody's focus", async ({ page, rig }) => {
  await enter(page, rig);
  const [number, placement] = [page.getByLabel("Number of the object"), page.getByLabel("How it lies")];
  await number.fill("1884.3");
  await placement.fill("upright");
  let release;
  const held = new Promise((done) => (release = done));
  await page.route("**/api/press", async (route) => {
    await held;
    await route.continue();
  });
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await number.fill("1884.4");
  await placement.fill("on its side");
  release();
  await expect(page.locator(".do > .told")).toContainText("safe on the disk");
  await expect(placement).toBeFocused();
  await expect(placement).toHaveValue("on its side");
  await expect(number).toHaveValue("1884.4");
});

test("a press that comes more than ten seconds late takes no capture, and the page says so", async ({ page, rig, expected }) => {
  expected.push("409");
  await enter(page, rig);
  const before = taken(rig);
  await page.route("**/api/press", (route) => {
    const asked = route.request().postDataJSON();
    // As if the process had begun anew meanwhile.
    route.continue({ postData: JSON.stringify({ ...asked, pressed_ms: asked.pressed_ms + 60_000 }) });
  });
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await expect(page.locator(".do > .told")).toContainText("more than ten seconds late");
  expect(taken(rig)).toBe(before);
});

test("what is typed about a capture goes to that capture, whatever is pressed meanwhile", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const [recording, first] = make(rig);
  await expect(page.locator(".say legend")).toContainText(first);
  await page.getByLabel("Why, or a note").fill("a hand");
  await page.getByLabel("Your name").fill("Ben");
  const [, second] = make(rig);
  await expect(page.locator(".facts")).toContainText(second);
  await expect(page.locator(".say legend")).toContainText(first);
  await expect(page.locator(".say .warning")).toContainText(second);
  await page.locator("[data-say=reject]").click();
  await expect(page.locator(".say legend")).toContainText(second);
  await expect(page.locator(".facts .decision")).toHaveCount(0);
  await page.evaluate((hash) => (location.hash = hash), `#/history/${recording}/${first}`);
  await expect(page.locator(".decision")).toHaveText("rejected");
  await expect(page.locator("main")).toContainText("(Ben)");
});

test("a session is closed, and its capture is accepted and noted about afterwards", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const name = `evening-${Date.now()}`;
  await closeSession(page);
  await page.getByLabel("Name of the session").fill(name);
  await page.getByLabel("Operator").fill("Ann");
  await page.getByLabel("Project").fill("Vases");
  await page.getByRole("button", { name: "Begin the session" }).click();
  await expect(page.locator(".facts")).toContainText(`Session ${name}`);
  const [recording, capture] = make(rig);
  await page.getByRole("button", { name: "Close the session" }).click();
  await expect(page.locator(".facts")).toContainText("No session is open");
  expect(rig.scand("info", `recordings/${recording}.mcap`)).toContain("Vases");
  await page.goto(`http://127.0.0.1:${rig.port}/#/history/${recording}/${capture}`);
  await page.locator("[data-say=accept]").click();
  await expect(page.locator("p.row > .decision")).toHaveText("accepted");
  await expect(page.locator(".say .told")).toHaveText(`Capture ${capture} is accepted.`);
  await page.getByLabel("Why, or a note").fill("The handle is glued.");
  await page.locator("[data-say=text]").click();
  await expect(page.locator(".say .told")).toHaveText(`The note on capture ${capture} is stored.`);
  await expect(page.locator("main")).toContainText("Note: The handle is glued.");
  expect(readdirSync(rig.path("recordings"))).toContain(`${recording}.notes.jsonl`);
});
