// A folder that `scand publish` made, served by a plain web server: the viewer shows each level of detail, names full
// of markup are text, and nothing leaves the machine.
import AxeBuilder from "@axe-core/playwright";
import { spawnSync } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";
import { test as base } from "@playwright/test";
import { expect, shot, watch } from "./fixtures.mjs";
import { SCAND } from "./rig.mjs";

const MARKUP = `"><img src=x onerror=alert(1)><script>alert(2)</script>`;
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".jpg": "image/jpeg", ".glb": "model/gltf-binary" };

/** Puts names full of markup into a model's own data, padded so that the file keeps its length. */
function makeHostile(path) {
  const bytes = readFileSync(path);
  const length = bytes.readUInt32LE(12);
  const json = JSON.parse(bytes.subarray(20, 20 + length).toString("utf8"));
  json.asset.extras = { ...json.asset.extras, subject: MARKUP, title: MARKUP, operator: MARKUP };
  // The packet says the same in other words; without it there is room.
  delete json.extensions;
  delete json.extensionsUsed;
  delete json.asset.extensions;
  const text = Buffer.from(JSON.stringify(json));
  if (text.length > length) throw new Error(`${text.length} bytes into ${length}`);
  Buffer.concat([text, Buffer.alloc(length - text.length, " ")]).copy(bytes, 20);
  writeFileSync(path, bytes);
}

const test = base.extend({
  site: [
    async ({}, use) => {
      const folder = mkdtempSync(join(tmpdir(), "scand-site-"));
      const scand = (...args) => {
        const found = spawnSync(SCAND, args, { cwd: folder, encoding: "utf8" });
        if (found.status !== 0) throw new Error(`scand ${args.join(" ")}: ${found.stderr}`);
      };
      scand("simulate", "--shape", "egg", "--textured", "--cameras", "6", "--size", "320x240", "--depth-cameras", "0", "--captures", "2", "--out", "egg.mcap");
      scand("replay", "egg.mcap", "-q");
      makeHostile(join(folder, "out/egg/egg-001/model.glb"));
      scand("publish", "out", "-o", "site", "--title", MARKUP, "--with", "operator,reasons");
      const root = join(folder, "site");
      const server = createServer((request, response) => {
        // Browsers ask for it unasked.
        if (request.url === "/favicon.ico") {
          response.writeHead(204).end();
          return;
        }
        const path = normalize(join(root, decodeURIComponent(new URL(request.url, "http://127.0.0.1").pathname)));
        if (!path.startsWith(root) || !statSync(path, { throwIfNoEntry: false })?.isFile()) {
          response.writeHead(404).end();
          return;
        }
        response.writeHead(200, { "content-type": TYPES[extname(path)] ?? "text/plain" }).end(readFileSync(path));
      }).listen(0, "127.0.0.1");
      await once(server, "listening");
      const objects = readdirSync(join(root, "objects"));
      await use({ address: `http://127.0.0.1:${server.address().port}`, objects });
      server.close();
      rmSync(folder, { recursive: true, force: true });
    },
    { scope: "worker", timeout: 120_000 },
  ],
  page: async ({ page }, use) => {
    const watched = watch(page);
    await use(page);
    expect(watched.errors).toEqual([]);
    expect(watched.foreign).toEqual([]);
  },
});

async function sound(page) {
  const { violations } = await new AxeBuilder({ page }).analyze();
  expect(violations.map((found) => `${found.id}: ${found.nodes[0]?.html}`)).toEqual([]);
}

test("the gallery leads to each object, and names full of markup are text", async ({ page, site }) => {
  await page.goto(`${site.address}/index.html`);
  await expect(page.locator("h1")).toHaveText(MARKUP);
  await expect(page.locator(".gallery li")).toHaveCount(2);
  await sound(page);
  await shot(page, "gallery");
  const hostile = page.locator(".gallery a", { hasText: "onerror" });
  await hostile.click();
  await expect(page.locator("h1")).toContainText(MARKUP);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  expect(await page.locator("img[src=x]").count()).toBe(0);
  await expect(page.locator("main")).toContainText(MARKUP);
});

test("a model is shown in each way and at full detail, and measured", async ({ page, site }) => {
  const plain = site.objects.find((name) => name.startsWith("object-"));
  await page.goto(`${site.address}/objects/${plain}/index.html`);
  await expect(page.locator("canvas[data-loaded]")).toBeVisible();
  for (const mode of ["shaded", "provenance", "error", "textured"]) {
    await page.locator(`[data-mode=${mode}]`).click();
    await expect(page.locator(`[data-mode=${mode}]`)).toHaveAttribute("aria-pressed", "true");
  }
  await page.locator("[data-mode=provenance]").click();
  const words = ["silhouettes", "carved by depth", "measured by depth", "interpolated", "a guess", "on the table"];
  await expect(page.locator(".legend li")).toHaveText(words);
  await page.locator("[data-mode=textured]").click();
  // What failed can be asked for again.
  const full = page.locator("[data-full]");
  await page.route("**/high.glb", (route) => route.fulfill({ status: 200, contentType: "text/plain", body: "no model" }));
  await full.click();
  await expect(page.locator(".viewer [role=status]")).toContainText("cannot be shown");
  await expect(full).toBeEnabled();
  await page.unroute("**/high.glb");
  await full.click();
  await expect(page.locator("canvas[data-loaded='high.glb']")).toBeVisible();
  await expect(full).toBeDisabled();
  await page.locator("[data-measure]").click();
  const box = await page.locator("canvas").boundingBox();
  for (const dx of [-20, 20]) {
    await page.mouse.click(box.x + box.width / 2 + dx, box.y + box.height / 2);
  }
  await expect(page.locator(".viewer [role=status]")).toContainText(/\d+\.\d mm between/);
  await sound(page);
  await shot(page, "object");
});

test("without a model to load, the picture stays", async ({ page, site }) => {
  const plain = site.objects.find((name) => name.startsWith("object-"));
  await page.route("**/*.glb", (route) => route.fulfill({ status: 200, contentType: "text/plain", body: "no model" }));
  await page.goto(`${site.address}/objects/${plain}/index.html`);
  await expect(page.locator(".viewer [role=status]")).toContainText("cannot be shown");
  await expect(page.locator("img.picture")).toBeVisible();
});
