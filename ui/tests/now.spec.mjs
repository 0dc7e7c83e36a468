// The large sign: what it says of the rig and of the last capture, and the tone that goes with it.
import AxeBuilder from "@axe-core/playwright";
import { renameSync } from "node:fs";
import { enter, expect, inGerman, make, shot, sign, test } from "./fixtures.mjs";
import { SCAND, until, USUAL_SKEW } from "./rig.mjs";

const SIGNS = [
  "away", "not_ready", "disk_full", "busy", "ready", "ready_without", "capturing", "hands_may_move", "safe", "green", "amber", "red",
  "failed", "model_failed",
];

test("each sign has a form and a word of its own, and says what to do, in each language", async ({ page, rig }) => {
  // What the page's process tells comes from the test.
  await page.addInitScript(() => {
    window.EventSource = class extends EventTarget {
      constructor() {
        super();
        window.events = this;
      }
      close() {}
    };
  });
  await enter(page, rig, "viewer");
  const tell = (sign, models = null) =>
    page.evaluate(([sign, models]) => {
      const daemon = { age_ms: 5, session: null, captures_left: 40, models, plates_age_h: 1 };
      const rest = { recording: null, age_ms: 5, last: null, object: null, remade: [], history: 1 };
      const now = { sign, capture: "a-0001", reasons: ["c00: opening"], daemon, ...rest };
      window.events.dispatchEvent(new MessageEvent("now", { data: JSON.stringify(now) }));
    }, [sign, models]);
  const differ = async () => {
    const [forms, words] = [new Set(), new Set()];
    for (const name of SIGNS) {
      await tell(name);
      await expect(page.locator("[data-sign]")).toHaveAttribute("data-sign", name);
      await expect(page.locator(".now .hint")).not.toHaveText("");
      forms.add(await page.locator(".now svg.sign").innerHTML());
      words.add(await page.locator(".now h1").textContent());
    }
    expect([forms.size, words.size]).toEqual([SIGNS.length, SIGNS.length]);
  };
  await differ();
  await inGerman(page, differ);
  // Each of them is readable, in light and in dark.
  for (const colorScheme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme });
    for (const name of SIGNS) {
      await tell(name);
      await expect(page.locator("[data-sign]")).toHaveAttribute("data-sign", name);
      const found = await new AxeBuilder({ page }).include(".now").withRules(["color-contrast"]).analyze();
      expect(found.violations.map(({ nodes }) => `${name}, ${colorScheme}: ${nodes[0].html}`)).toEqual([]);
    }
  }
  await tell("busy");
  await expect(page.locator(".now h1")).toHaveText("Please wait");
  // Of a daemon that told before the press, no number stands beside "The model is being made".
  const idle = { waiting: 0, running: [], expected_s: null };
  await tell("ready", idle);
  await expect(page.locator(".facts")).toContainText("Models to be made: 0");
  await tell("safe", idle);
  await expect(page.locator(".now .hint")).toHaveText("The model is being made.");
  await expect(page.locator(".facts")).not.toContainText("Models to be made");
  await tell("safe", { ...idle, waiting: 1 });
  await expect(page.locator(".facts")).toContainText("Models to be made: 1");
  await tell("hands_may_move");
  await expect(page.locator(".now h1")).toHaveText("Hands may move");
});

/** Notes each sign that a page shows from then on, with its word; a function that tells them so far. */
async function noteSigns(page) {
  await page.evaluate(() => {
    window.signs = [];
    const note = () => {
      const { sign } = document.querySelector("[data-sign]").dataset;
      const shown = `${sign}: ${document.querySelector(".now h1").textContent.trim()}`;
      if (shown !== window.signs.at(-1)) window.signs.push(shown);
    };
    const watched = { subtree: true, childList: true, characterData: true, attributes: true, attributeFilter: ["data-sign"] };
    new MutationObserver(note).observe(document.querySelector("scand-now"), watched);
  });
  return () => page.evaluate(() => window.signs);
}

test("a press is followed by `Hold still`, `Hands may move` and `Safe on disk`, none before its time, on a screen that only looks", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig, "viewer");
  const signs = await noteSigns(page);
  const way = ["capturing: Hold still", "hands_may_move: Hands may move", "safe: Safe on disk"];
  let seen = [];
  // A quick disk makes a capture durable before the next event is sent, a tenth of a second later: a sign may be left
  // out then, but none comes before its time.
  for (let press = 0; press < 10 && !seen.includes(way[0]); press++) {
    await sign(page, "ready", "green", "amber", "red", "failed");
    const before = (await signs()).length;
    rig.scand("trigger", "--socket", "scand.sock", "--until", "durable");
    const since = async () => (await signs()).slice(before).filter((name) => way.includes(name));
    await expect.poll(since).toContain(way[2]);
    seen = await since();
    expect(seen).toEqual(way.filter((name) => seen.includes(name)));
  }
  expect(seen).toContain(way[0]);
});

test("a daemon that is away, a capture that fails, a red model and a camera that is away are told", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  await rig.stop("daemon");
  await sign(page, "away");
  const health = await page.request.get(`http://127.0.0.1:${rig.port}/healthz`);
  expect([health.status(), await health.text()]).toEqual([503, "the daemon does not answer\n"]);
  // A capture whose pictures are further apart than is allowed is none.
  rig.options.largestSkew = 0.000001;
  await rig.startDaemon();
  await sign(page, "ready");
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await sign(page, "failed");
  await expect(page.locator(".now h1")).toHaveText("Failed: press again");
  await expect(page.locator(".now .reasons li").first()).toContainText("ms");
  await expect(page.locator(".do > .told")).toContainText("The capture failed: ");
  await inGerman(page, () => expect(page.locator(".now .reasons li").first()).toContainText(/liegen \S+ ms auseinander, von c0/));
  await rig.stop("daemon");
  rig.options.largestSkew = undefined;
  // The cameras are not asked at the very same moment; here that is too much.
  rig.options.skew = [0.000001, 0.000002];
  await rig.startDaemon();
  // The failure is still the last that happened.
  await sign(page, "ready", "failed");
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await sign(page, "red");
  await shot(page, "red");
  await inGerman(page, () => expect(page.locator(".now .reasons")).toContainText(/Farbkameras liegen \S+ ms auseinander/));
  await rig.stop("cameras", "SIGKILL");
  await page.getByRole("link", { name: "State" }).click();
  await expect(page.locator("main")).toContainText("is away", { timeout: 40_000 });
  await expect(page.locator("main")).toContainText("known when a camera is ready", { timeout: 40_000 });
  await expect(page.locator("main")).not.toContainText("captures fit on the disk");
  await inGerman(page, () => expect(page.locator("main")).toContainText(/c00 fehlt \([^)]*127\.0\.1\.1 antwortet/));
  await expect(page.locator("main")).toContainText(/Calibration\s*\d+ (s|min) old/);
  await expect(page.locator("main")).toContainText(/Version of the daemon: \d+\.\d+/);
  await shot(page, "state");
  await page.getByRole("link", { name: "Now" }).click();
  await sign(page, "not_ready");
  rig.inside("cameras", SCAND, ["simulate", "--serve", "served.mcap"]);
  await sign(page, "ready");
  // Where captures are taken without cameras that are away, they are named all the same.
  await rig.stop("daemon");
  rig.options.goOn = true;
  rig.options.skew = USUAL_SKEW;
  await rig.startDaemon();
  await sign(page, "ready");
  await rig.stop("cameras", "SIGKILL");
  await sign(page, "ready_without");
  await expect(page.locator(".now .reasons li").first()).toContainText("c00");
  // Not before every one is missed: a camera that is still taken for there would answer nothing in the next capture.
  await until("every camera is missed", () => Object.values(rig.status().cameras).every((camera) => camera.state !== "ready"));
  rig.inside("cameras", SCAND, ["simulate", "--serve", "served.mcap"]);
  await sign(page, "ready");
  rig.options.goOn = false;
});

test("without background pictures the page says so before a press, and afterwards why there is no model", async ({ page, rig }) => {
  await rig.prepare();
  await enter(page, rig);
  await rig.stop("daemon");
  const [plates, aside] = ["recordings/plates", "plates-aside"].map((name) => rig.path(name));
  renameSync(plates, aside);
  try {
    await rig.startDaemon();
    await sign(page, "ready");
    await expect(page.locator(".now .hint")).toContainText("first take background pictures");
    // It is not the green sign, and what to do is in view beside it.
    await expect(page.locator(".now h1")).toHaveText("No background pictures");
    await expect(page.locator(".now")).toHaveCSS("background-color", "rgb(255, 191, 46)");
    const ask = page.getByRole("button", { name: "Take background pictures" });
    await expect(ask).toHaveCount(1);
    await expect(page.locator(".now").getByRole("button", { name: "Take background pictures" })).toBeInViewport();
    await ask.click();
    await expect(page.locator(".now")).toContainText("Is the rig empty?");
    await page.getByRole("button", { name: "Cancel" }).click();
    await page.getByRole("button", { name: "Press", exact: true }).click();
    await sign(page, "model_failed");
    await expect(page.locator(".now h1")).toHaveText("No model");
    const reason = page.locator(".now .reasons li").first();
    await expect(reason).toContainText("background");
    await inGerman(page, () => expect(reason).toContainText("gibt es kein Hintergrundbild"));
    // The capture is there all the same.
    await page.locator(".facts a").click();
    await expect(page.locator("p.row > .verdict")).toContainText("No model");
    await expect(page.locator(".photographs button")).toHaveCount(rig.options.cameras);
    await expect(page.locator("canvas")).toHaveCount(0);
  } finally {
    await rig.stop("daemon");
    renameSync(aside, plates);
    await rig.startDaemon();
  }
});

test("a tone is played once for its news, and not again when the connection is back", async ({ page, rig, expected }) => {
  expected.push("net::ERR");
  await page.addInitScript(() => {
    localStorage.setItem("scand-sound", "on");
    const node = (more) => ({ connect: (to) => to, ...more });
    window.tones = 0;
    window.AudioContext = class {
      state = "suspended";
      currentTime = 0;
      async resume() {
        this.state = "running";
      }
      createGain = () => node({ gain: {} });
      createOscillator = () => {
        window.tones++;
        return node({ frequency: {}, start() {}, stop() {} });
      };
    };
  });
  await rig.prepare();
  await enter(page, rig, "viewer", rig.wirePort);
  await sign(page, "ready", "green", "amber", "red");
  const [, capture] = make(rig);
  await sign(page, "green", "amber", "red");
  await expect(page.locator(".now .about")).toContainText(capture);
  const tones = () => page.evaluate(() => window.tones);
  await expect.poll(tones).toBeGreaterThan(0);
  const before = await tones();
  rig.wire.cut();
  await sign(page, "unknown");
  rig.wire.mend();
  await sign(page, "green", "amber", "red", "ready");
  await page.waitForTimeout(500);
  expect(await tones()).toBe(before);
});
