// An object's whole way on a phone and on a wall screen, the keyboard alone, and what axe finds.
import AxeBuilder from "@axe-core/playwright";
import { enter, expect, make, shot, sign, taken, test } from "./fixtures.mjs";

/** An object's whole way, as an operator goes it on one screen: nothing that a step shows is cut off at the side. */
async function goTheWholeWay(page, rig, hasTouch) {
  const press = async (target) => {
    await (hasTouch ? target.tap() : target.click());
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    expect(wide, "wider than the screen by").toBeLessThanOrEqual(0);
  };
  const button = (name) => page.getByRole("button", { name, exact: true });
  const part = (name) => page.getByRole("navigation").getByRole("link", { name });
  const facts = page.locator(".facts");
  const [number, session] = [`55.${Date.now()}`, `screen-${Date.now()}`];
  await rig.show("background");
  await enter(page, rig);
  const [begin, close] = [button("Begin the session"), button("Close the session")];
  await expect(begin.or(close)).toBeVisible();
  if (await close.isVisible()) await press(close);
  await press(button("Take background pictures"));
  await press(button("Yes, take them"));
  await expect(page.getByText("Put the object in now.")).toBeVisible();
  rig.isPrepared = true;
  await rig.show("captures");
  await page.getByLabel("Name of the session").fill(session);
  await page.getByLabel("Operator").fill("Ann");
  await press(begin);
  await expect(facts).toContainText(`Session ${session}`);
  // The scanner types, wherever the focus is.
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.type(number);
  await page.keyboard.press("Enter");
  await expect(page.getByLabel("Number of the object")).toHaveValue(number);
  const before = taken(rig);
  await press(button("Press"));
  await expect(facts).toContainText(`object ${number}`);
  await expect(page.locator(".now h1")).toBeInViewport();
  await sign(page, "green", "amber");
  expect(taken(rig)).toBe(before + 1);
  const name = (await facts.locator("a").textContent()).trim();
  await page.getByLabel("Why, or a note").fill("My hand was in it.");
  await press(page.locator("[data-say=reject]"));
  await expect(facts.locator(".decision")).toHaveText("rejected");
  await press(page.locator("[data-say=accept]"));
  await expect(facts.locator(".decision")).toHaveText("accepted");
  await press(part("History"));
  await press(page.getByRole("main").getByRole("link").filter({ hasText: number }));
  await expect(page.locator("h1")).toHaveText(name);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await expect(page.locator("p.row > .decision")).toHaveText("accepted");
  await press(page.locator("[data-mode=error]"));
  await expect(page.locator("[data-mode=error]")).toHaveAttribute("aria-pressed", "true");
  await press(page.locator("[data-measure]"));
  await measure(page, hasTouch);
  await expect(page.locator(".viewer [role=status]")).toContainText(/\d+\.\d mm between/);
  await press(page.getByText("Make it again with other settings"));
  await page.getByLabel("Cells along the object").fill("60");
  await press(button("Make it again"));
  const remade = page.locator("[data-remade] a");
  await expect(remade).toHaveText(`${name}.remake-1`, { timeout: 60_000 });
  await press(remade);
  await expect(page.locator("h1")).toContainText("made again");
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  await press(part("Now"));
  await press(close);
  await expect(facts).toContainText("No session is open");
}

/** Touches, or clicks, two points of the model that the viewer shows. */
async function measure(page, hasTouch) {
  const canvas = page.locator("canvas");
  await canvas.evaluate((shown) => shown.scrollIntoView({ block: "center" }));
  const box = await canvas.boundingBox();
  for (const side of [-1, 1]) {
    const [x, y] = [box.x + box.width * (0.5 + side * 0.03), box.y + box.height * 0.52];
    await (hasTouch ? page.touchscreen.tap(x, y) : page.mouse.click(x, y));
  }
}

// The other cases go on a tablet of 1024x768.
const SCREENS = [
  { screen: "a phone", viewport: { width: 360, height: 740 }, hasTouch: true },
  { screen: "a wall screen", viewport: { width: 1920, height: 1080 }, hasTouch: false },
];
for (const { screen, viewport, hasTouch } of SCREENS) {
  test.describe(`on ${screen}`, () => {
    test.use({ viewport, hasTouch });
    test("an object goes its whole way: background pictures, session, scanned number, press, decision, viewer, made again", async ({ page, rig }) => {
      test.setTimeout(180_000);
      await goTheWholeWay(page, rig, hasTouch);
    });
  });
}

test("axe finds nothing serious at three sizes, in light and dark, and nothing is wider than the screen", async ({ page, rig }) => {
  test.setTimeout(180_000);
  await rig.prepare();
  await enter(page, rig);
  const [recording, capture] = make(rig);
  const sizes = [
    [360, 740, "light"],
    [1024, 768, "dark"],
    [1920, 1080, "light"],
  ];
  for (const [width, height, colorScheme] of sizes) {
    await page.setViewportSize({ width, height });
    await page.emulateMedia({ colorScheme });
    for (const part of ["now", "look", "history", "state", `history/${recording}/${capture}`]) {
      await page.goto(`http://127.0.0.1:${rig.port}/#/${part}`);
      await expect(page.locator("main h1")).toBeVisible();
      if (part === "look") await expect(page.locator(".looks img")).toHaveCount(rig.options.cameras);
      await page.waitForTimeout(400);
      if (part === "now") {
        // Read from three metres: on a tablet of 20 cm such letters are more than 1 cm high.
        const size = await page.locator(".now h1").evaluate((heading) => parseFloat(getComputedStyle(heading).fontSize));
        expect(size / width, `the sign's word at ${width}`).toBeGreaterThan(0.06);
      }
      const found = await new AxeBuilder({ page }).analyze();
      const serious = found.violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
      expect(serious.map(({ id, nodes }) => `${part} ${width} ${id}: ${nodes[0].html}`)).toEqual([]);
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      expect(wide, `${part} at ${width}`).toBeLessThanOrEqual(0);
      const small = await page.evaluate(() =>
        [...document.querySelectorAll("button, input, select, summary, a[href]")]
          .map((target) => [target, target.getBoundingClientRect()])
          .filter(([target, { width, height }]) => target.getClientRects().length > 0 && Math.min(width, height) < 47.9)
          .map(([target, { width, height }]) => `${width}x${height}: ${target.outerHTML}`),
      );
      expect(small, `${part} at ${width}`).toEqual([]);
    }
    // The colours of the other scheme, where most of them are.
    await page.emulateMedia({ colorScheme: colorScheme === "dark" ? "light" : "dark" });
    for (const part of ["now", "state"]) {
      await page.goto(`http://127.0.0.1:${rig.port}/#/${part}`);
      await expect(page.locator("main h1")).toBeVisible();
      const found = await new AxeBuilder({ page }).withRules(["color-contrast"]).analyze();
      expect(found.violations.map(({ nodes }) => `${part} ${width}: ${nodes[0].html}`)).toEqual([]);
    }
  }
  await page.setViewportSize({ width: 360, height: 740 });
  await page.goto(`http://127.0.0.1:${rig.port}/#/now`);
  await shot(page, "phone");
});

test("the keyboard alone presses, and the page speaks German", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  const before = taken(rig);
  await sign(page, "ready", "green", "amber", "red");
  await page.getByRole("button", { name: "Deutsch" }).click();
  await expect(page.getByRole("button", { name: "Auslösen" })).toBeVisible();
  await expect(page.locator("html")).toHaveAttribute("lang", "de");
  await expect(page).toHaveTitle(/^(Bereit|Modell \S+) – scand$/); // German
  await page.getByLabel("Nummer des Objekts").focus();
  await page.keyboard.press("Tab");
  await expect(page.locator("#placement")).toBeFocused();
  await page.keyboard.press("Tab");
  await expect(page.getByRole("button", { name: "Auslösen" })).toBeFocused();
  await page.keyboard.press("Enter");
  await expect(page.locator(".do > .told")).toContainText("sicher gespeichert");
  expect(taken(rig)).toBe(before + 1);
  await page.getByRole("button", { name: "English" }).click();
});
