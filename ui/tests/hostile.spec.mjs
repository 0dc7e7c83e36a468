// Requests that mean no good, names that are full of markup, and where the secrets of who is signed in are not.
import { randomBytes } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { createConnection } from "node:net";
import { enter, expect, pressFor, shot, sign, taken, test } from "./fixtures.mjs";

const MARKUP = `<img src=x onerror="alert(1)"><script>alert(2)</script>`;

test("names, numbers and notes full of markup are text", async ({ page, rig, expected }) => {
  // Of recordings that are none.
  expected.push("404");
  await rig.prepare();
  await enter(page, rig);
  await page.getByLabel("Number of the object").fill(MARKUP);
  await page.getByRole("button", { name: "Press", exact: true }).click();
  await expect(page.locator(".do > .told")).toContainText("safe on the disk");
  await expect(page.locator(".facts")).toContainText(MARKUP);
  await sign(page, "green", "amber");
  await page.getByLabel("Why, or a note").fill(MARKUP);
  await page.locator("[data-say=reject]").click();
  await expect(page.locator(".say .told")).toContainText(`is rejected: ${MARKUP}`);
  await expect(page.locator(".facts .decision")).toHaveText("rejected");
  await page.locator(".facts a").click();
  await expect(page.locator(".decision")).toHaveText("rejected");
  await expect(page.locator("main")).toContainText(MARKUP);
  // What holds is marked, what is taken back has a name, and a note without a name says so.
  await expect(page.locator("[data-say=reject]")).toHaveAttribute("aria-pressed", "true");
  await expect(page.locator("[data-say=accept]")).not.toHaveAttribute("aria-pressed");
  await expect(page.locator("[data-holds]")).toHaveText("It is rejected now.");
  await expect(page.locator("main")).toContainText(/\(no name given\)[^(]*\d{4}/);
  await expect(page.locator("[data-say=clear]")).toHaveText("Take “rejected” back");
  await page.locator("[data-say=clear]").click();
  await expect(page.locator(".decision")).toHaveCount(0);
  await expect(page.locator("[data-say=clear]")).toHaveText("Take the decision back");
  await page.getByRole("link", { name: "History" }).click();
  await expect(page.locator(".strip")).toContainText(MARKUP);
  await expect(page.locator(".strip li")).not.toHaveCount(0);
  await shot(page, "history");
  expect(await page.locator("main img[src=x]").count()).toBe(0);
  for (const address of ["#/history/%3Cimg%20src=x%20onerror=alert(1)%3E", "#/history/../..", "#/%3Cscript%3E", "#/history/%"]) {
    await page.goto(`http://127.0.0.1:${rig.port}/${address}`);
    await expect(page.locator("nav")).toBeVisible();
  }
});

/** Requests that mean no good, each with something that differs from the last one's. No links are guessed: the page would
 * refuse every link for a minute, those of the next tests too. */
function hostile(port) {
  const [host, guess] = [`127.0.0.1:${port}`, randomBytes(32).toString("hex")];
  const request = (line, headers = "", body = "") => `${line} HTTP/1.1\r\nHost: ${host}\r\nConnection: close\r\n${headers}\r\n${body}`;
  const json = (body) => `Content-Type: application/json\r\nOrigin: http://${host}\r\nContent-Length: ${body.length}\r\n`;
  const press = `{"press_id":"${guess}"}`;
  return [
    request(`GET /../../${guess}`),
    request(`GET /api/models/..%2f..%2f${guess}/report.json`, `Cookie: scand=${guess}\r\n`),
    request(`GET /${guess.repeat(60)}`),
    request("GET /", `X-${guess}: ${guess.repeat(30)}\r\n`.repeat(20)),
    request("GET /api/events", `Cookie: scand=${guess}\r\nX-Forwarded-For: 10.${[...randomBytes(3)].join(".")}\r\n`),
    request("POST /api/press", `${json(press)}Cookie: scand=${guess}\r\nX-Scand-Token: ${guess}\r\n`, press),
    `GET / HTTP/1.1\r\nHost: ${guess}.example\r\nConnection: close\r\n\r\n`,
    // What never ends, and what is no request; the client leaves in the middle.
    `POST /api/press HTTP/1.1\r\nHost: ${host}\r\nContent-Length: 999999999\r\n\r\n{"press_id":"${guess}`,
    `GET /api/state HTTP/1.1\r\nHost: ${host}\r\nX-Long: ${guess.repeat(8)}`,
    randomBytes(600),
  ];
}

/** Sends a request, and leaves after its answer or soon. */
function send(port, bytes) {
  return new Promise((done) => {
    const socket = createConnection(port, "127.0.0.1", () => socket.write(bytes));
    socket.setTimeout(50, () => socket.destroy());
    socket.on("data", () => {});
    socket.on("error", () => {});
    socket.on("close", done);
  });
}

test("hostile requests by the thousand press nothing, and the page's memory stays as it was", async ({ rig }) => {
  await rig.prepare();
  const { pid } = rig.children.get("page");
  const memory = () => Number(/VmRSS:\s*(\d+) kB/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) / 1000;
  const before = taken(rig);
  const rounds = async (count) => {
    for (let n = 0; n < count; n++) await Promise.all(hostile(rig.port).map((bytes) => send(rig.port, bytes)));
    return memory();
  };
  // The first ones make the pools and tables grow to their size.
  const megabytes = [await rounds(40)];
  for (let part = 0; part < 3; part++) megabytes.push(await rounds(40));
  const grown = megabytes.slice(1).map((now, n) => now - megabytes[n]);
  const told = `${megabytes.map((value) => value.toFixed(1)).join(", ")} MB`;
  console.log(`the page's memory after each 400 hostile requests: ${told}`);
  // What is kept of each request would show in every part.
  expect(Math.min(...grown), told).toBeLessThan(0.5);
  expect(megabytes.at(-1) - megabytes[0], told).toBeLessThan(8);
  expect(taken(rig)).toBe(before);
  const health = await fetch(`http://127.0.0.1:${rig.port}/healthz`);
  expect(health.status).toBe(200);
});

test("a device that is signed out is out at once, its page says so, and its secrets are nowhere", async ({ page, rig, expected }) => {
  expected.push("401");
  await rig.prepare();
  const link = rig.link();
  await page.goto(link);
  await expect(page.locator("nav")).toBeVisible();
  // What it presses is recorded.
  await pressFor(page, rig, "7.1");
  const [cookie] = await page.context().cookies();
  const secrets = [link.split("#pair=")[1], cookie.value];
  const files = ["page.log", "daemon.log", "rig.toml", "page.toml", "page-state/sessions.json"];
  const recordings = readdirSync(rig.path("recordings")).filter((name) => /\.(mcap|jsonl)/.test(name));
  expect(recordings.length).toBeGreaterThan(0);
  for (const name of [...files, ...recordings.map((recording) => `recordings/${recording}`)]) {
    const bytes = readFileSync(rig.path(name));
    expect(secrets.filter((secret) => bytes.includes(secret)), name).toEqual([]);
  }
  // A support bundle has, of the rig, the logs and the configuration that were looked through above, and these.
  const status = rig.scand("status", "--socket", "scand.sock", "--json");
  for (const text of [status, readFileSync(rig.path("calibration.toml"), "utf8")]) {
    expect(secrets.filter((secret) => text.includes(secret))).toEqual([]);
  }
  rig.scand("page", "revoke", "--all", "--config", "page.toml");
  await expect(page.locator("pre")).toHaveText("scand page pair", { timeout: 20_000 });
  await expect(page.getByRole("alert")).toHaveText("You are signed out: somebody signed this device out, or its time is up.");
  const kept = readFileSync(rig.path("page-state/sessions.json"), "utf8");
  expect(kept.trim()).toBe("[]");
});
