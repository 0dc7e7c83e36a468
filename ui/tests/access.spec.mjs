// Who may see and do what: links, signing in and out, a viewer, TLS, and the headers of every answer.
import { enter, expect, inGerman, sign, test, watch } from "./fixtures.mjs";

test("a link signs one device in, its token leaves the address, and who is not signed in sees nothing", async ({ page, rig, browser, expected }) => {
  expected.push("401", "403");
  await page.goto(`http://127.0.0.1:${rig.port}/`);
  await expect(page.locator("pre")).toHaveText("scand page pair");
  // The command prints the link, and the same as a picture for a tablet's camera.
  const said = rig.scand("page", "pair", "--role", "viewer", "--config", "page.toml");
  expect(said).toMatch(/^http:\/\/127\.0\.0\.1:\d+\/#pair=[0-9a-f]{64}$/m);
  expect(said).toContain("within ten minutes");
  expect(said.split("\n").filter((line) => /^[ ▀▄█]{30,}$/.test(line)).length).toBeGreaterThan(15);
  // A link that is opened where the page is already changes nothing but what is behind `#`.
  const link = rig.link();
  await page.goto(link);
  await expect(page.locator("nav")).toBeVisible();
  expect(page.url()).not.toContain("pair");
  const [cookie] = await page.context().cookies();
  expect(cookie).toMatchObject({ httpOnly: true, sameSite: "Strict" });
  const other = await browser.newPage();
  await other.goto(link);
  await expect(other.getByRole("alert")).toContainText("was used");
  await other.close();
});

test("every answer has its headers, and another name is refused", async ({ page, rig }) => {
  await enter(page, rig);
  const answer = await page.request.get(`http://127.0.0.1:${rig.port}/`);
  const headers = answer.headers();
  expect(headers["content-security-policy"]).toContain("default-src 'none'");
  expect(headers["content-security-policy"]).toContain("frame-ancestors 'none'");
  expect(headers["content-security-policy"]).not.toContain("unsafe-inline");
  expect(headers["x-content-type-options"]).toBe("nosniff");
  const renamed = await page.request.get(`http://127.0.0.1:${rig.port}/`, { headers: { Host: "rig.evil.example" } });
  expect(renamed.status()).toBe(421);
  const framed = await page.evaluate(async () => {
    const found = await fetch("/licences.txt");
    return (await found.text()).includes("three");
  });
  expect(framed).toBe(true);
});

test("a viewer sees everything and has nothing to press", async ({ page, rig, expected }) => {
  expected.push("403");
  await enter(page, rig, "viewer");
  await sign(page, "ready", "green", "amber");
  await expect(page.getByRole("button", { name: "Press", exact: true })).toHaveCount(0);
  const refused = await page.evaluate(async () => {
    const me = await (await fetch("/api/me")).json();
    const headers = { "Content-Type": "application/json", "X-Scand-Token": me.token };
    const answer = await fetch("/api/press", { method: "POST", headers, body: `{"press_id":"page-viewer"}` }).catch(() => null);
    return answer.status;
  }).catch(String);
  expect(refused).toBe(403);
});

for (const isOlderFirst of [true, false]) {
  const when = isOlderFirst ? "before" : "after";
  test(`who signs in anew is that one, also if an older answer comes ${when} the new one`, async ({ page, rig, expected }) => {
    expected.push("401");
    await enter(page, rig, "viewer");
    let [asked, isNew] = [0, false];
    let pass;
    const later = new Promise((resolve) => (pass = resolve));
    await page.route("**/api/me", async (route) => {
      asked++;
      const isOlder = !isNew;
      const response = await route.fetch();
      if (isOlder) await later;
      else if (isOlderFirst) {
        pass();
        await page.waitForTimeout(500);
      }
      await route.fulfill({ response });
      pass();
    });
    await page.reload();
    await expect.poll(() => asked).toBeGreaterThan(0);
    isNew = true;
    await page.goto(rig.link("operator"));
    await expect(page.getByRole("button", { name: /^(Begin the session|Press)$/ }).first()).toBeVisible();
    await page.waitForTimeout(500);
    await page.unroute("**/api/me");
    // With the token of another session, this would be refused.
    await page.getByRole("button", { name: "Sign out" }).click();
    await expect(page.locator("pre")).toHaveText("scand page pair");
  });
}

test("who signs out on the page is out, and a reload brings nothing back", async ({ page, rig, expected }) => {
  expected.push("401");
  await enter(page, rig, "viewer");
  await page.getByRole("button", { name: "Sign out" }).click();
  await expect(page.locator("pre")).toHaveText("scand page pair");
  await page.reload();
  await expect(page.locator("pre")).toHaveText("scand page pair");
  await expect(page.locator("nav")).toHaveCount(0);
});

test("a device that is signed out by its name is out alone, and a new link signs it in again", async ({ page, rig, browser, expected }) => {
  expected.push("401");
  const listed = () => {
    const lines = rig.scand("page", "sessions", "--config", "page.toml").trim().split("\n");
    return lines.map((line) => line.split(" ")[0]);
  };
  const before = listed();
  await enter(page, rig);
  const [own] = listed().filter((id) => !before.includes(id));
  const other = await browser.newPage();
  const watched = watch(other);
  await enter(other, rig, "viewer");
  await page.getByRole("link", { name: "State" }).click();
  await expect(page.locator(".cameras .card")).toHaveCount(rig.options.cameras);
  expect(rig.scand("page", "revoke", own, "--config", "page.toml")).toContain("1 session ended");
  // Within four seconds, by docs/page.md; a machine that is busy may take longer.
  await expect(page.getByRole("heading", { name: "Who are you?" })).toBeVisible({ timeout: 15_000 });
  await expect(page.getByRole("alert")).toContainText("You are signed out");
  await expect(page.locator(".cameras .card")).toHaveCount(0);
  await expect(page.locator("nav")).toHaveCount(0);
  await inGerman(page, () => expect(page.getByRole("alert")).toContainText("Sie sind abgemeldet")); // German
  await sign(other, "ready", "green", "amber", "red");
  await page.goto(rig.link("viewer"));
  await sign(page, "ready", "green", "amber", "red");
  await expect(page.getByRole("alert")).toHaveCount(0);
  await expect(page.getByRole("button", { name: "Press", exact: true })).toHaveCount(0);
  expect(watched.errors).toEqual([]);
  await other.close();
});

test("over TLS, with a certificate of the administrator's, the session's cookie never leaves TLS", async ({ browser, rig }) => {
  const origin = await rig.startPageWithTls();
  const context = await browser.newContext({ ignoreHTTPSErrors: true });
  const page = await context.newPage();
  const watched = watch(page);
  await page.goto(`${origin}/${rig.token("viewer", "page-tls.toml")}`);
  await sign(page, "ready", "green", "amber", "red");
  const [cookie] = await context.cookies();
  expect(cookie).toMatchObject({ name: "__Host-scand", secure: true, httpOnly: true, sameSite: "Strict" });
  const plain = await page.request.get(origin.replace("https", "http")).catch(() => null);
  expect(plain).toBe(null);
  expect(watched.foreign).toEqual([]);
  expect(watched.errors).toEqual([]);
  await context.close();
  await rig.stop("page-tls");
});
