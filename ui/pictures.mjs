// The pictures of the page in docs/operating.md, taken of the rig of `make page-demo`: before a press, after it, and the
// capture's page.
import { chromium } from "@playwright/test";
import config from "./playwright.config.mjs";

/** Takes the pictures into a folder. */
export async function takePictures(rig, folder) {
  const { viewport, locale, launchOptions } = config.use;
  const browser = await chromium.launch(launchOptions);
  try {
    const page = await browser.newPage({ viewport, locale });
    page.setDefaultTimeout(180_000);
    const take = async (name) => {
      await page.evaluate(() => scrollTo(0, 0));
      await page.screenshot({ path: `${folder}/page-${name}.png` });
    };
    await page.goto(rig.link());
    await page.locator("[data-sign=ready]").waitFor();
    await take("ready");
    await page.getByLabel("Number of the object").fill("1884.3");
    await page.getByRole("button", { name: "Press", exact: true }).click();
    await page.locator("[data-sign=green], [data-sign=amber], [data-sign=red]").waitFor();
    await take("verdict");
    await page.locator(".facts a").click();
    await page.locator("canvas[data-loaded]").waitFor();
    await page.locator(".photographs img").first().waitFor();
    await take("capture");
  } finally {
    await browser.close();
  }
}
