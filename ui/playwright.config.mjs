// The browser is Debian's; the tests share one rig and run one after the other.
import { defineConfig } from "@playwright/test";

const quiet = ["quic", "background-networking", "component-update", "sync", "default-apps", "domain-reliability"];

export default defineConfig({
  testDir: "tests",
  testMatch: "*.spec.mjs",
  workers: 1,
  timeout: 90_000,
  expect: { timeout: 20_000 },
  repeatEach: Number(process.env.N ?? 1),
  reporter: [["list"]],
  outputDir: "test-results",
  use: {
    browserName: "chromium",
    viewport: { width: 1024, height: 768 },
    locale: "en-GB",
    trace: "off",
    launchOptions: {
      executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
      args: ["--no-sandbox", "--no-first-run", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", ...quiet.map((name) => `--disable-${name}`)],
    },
  },
});
