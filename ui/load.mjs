// `make page-load`: how many bytes a model is on the wire, how long Chromium that is held to 20 Mbit/s takes from the
// request until the viewer shows it, each time without the browser's cache, and how many frames a second it draws while
// the model is turned. It measures; it judges nothing.
import { chromium } from "@playwright/test";
import { statSync } from "node:fs";
import config from "./playwright.config.mjs";
import { Rig } from "./tests/rig.mjs";

const LOADS = Number(process.env.LOADS ?? 4);
const BYTES_A_SECOND = 20e6 / 8;
const isModel = (found) => found.url().endsWith("/view.glb");

/** Milliseconds from the request of a model until it is shown, and its bytes on the wire. */
async function load(page, address) {
  await page.goto("about:blank");
  const asked = page.waitForRequest(isModel).then(() => performance.now());
  const answered = page.waitForResponse(isModel);
  await page.goto(address);
  await page.locator("canvas[data-loaded]").waitFor();
  const took = performance.now() - (await asked);
  return [took, Number((await answered).headers()["content-length"])];
}

/** How many frames a second are drawn while a hand turns the model for some seconds, and how long the longest took, in
 * ms. This browser draws without a graphics card. */
async function turn(page, seconds = 3) {
  const box = await page.locator("canvas").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.evaluate(() => {
    window.drawn = [];
    const next = (now) => {
      window.drawn.push(now);
      window.drawing = requestAnimationFrame(next);
    };
    window.drawing = requestAnimationFrame(next);
  });
  await page.mouse.move(x, y);
  await page.mouse.down();
  const end = performance.now() + seconds * 1000;
  for (let n = 0; performance.now() < end; n++) await page.mouse.move(x + 150 * Math.sin(n / 30), y);
  await page.mouse.up();
  const drawn = await page.evaluate(() => {
    cancelAnimationFrame(window.drawing);
    return window.drawn;
  });
  const took = drawn.slice(1).map((now, n) => now - drawn[n]);
  return [(1000 * took.length) / (drawn.at(-1) - drawn[0]), Math.max(...took)];
}

const rig = new Rig({ cameras: 11, size: "640x480", resolution: Number(process.env.RESOLUTION ?? 240) });
let browser;
try {
  await rig.start();
  await rig.prepare();
  const lines = rig.scand("trigger", "--socket", "scand.sock", "--until", "done", "--json").trim().split("\n");
  const name = JSON.parse(lines.pop()).model.split("/").slice(-2).join("/");
  browser = await chromium.launch(config.use.launchOptions);
  const page = await browser.newPage();
  page.setDefaultTimeout(120_000);
  await page.goto(rig.link("viewer"));
  await page.locator("nav").waitFor();
  const address = `http://127.0.0.1:${rig.port}/#/history/${name}`;
  // The small form is made when it is asked for first, or after `done`.
  await load(page, address);
  const session = await page.context().newCDPSession(page);
  await session.send("Network.enable");
  await session.send("Network.setCacheDisabled", { cacheDisabled: true });
  const held = { offline: false, latency: 2, downloadThroughput: BYTES_A_SECOND, uploadThroughput: BYTES_A_SECOND };
  await session.send("Network.emulateNetworkConditions", held);
  const megabytes = (bytes) => (bytes / 1e6).toFixed(2);
  console.log(`the daemon's model: ${megabytes(statSync(rig.path(`models/${name}/model.glb`)).size)} MB`);
  for (let n = 0; n < LOADS; n++) {
    const [took, bytes] = await load(page, address);
    console.log(`on the wire ${megabytes(bytes)} MB, shown after ${(took / 1000).toFixed(2)} s`);
  }
  const [rate, longest] = await turn(page);
  console.log(`turned by hand: ${rate.toFixed(0)} frames a second, the longest took ${longest.toFixed(0)} ms`);
} finally {
  await browser?.close();
  await rig.end();
}
