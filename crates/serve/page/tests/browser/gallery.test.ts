// The gallery of a results folder with two runs.

import assert from "node:assert/strict";
import { test } from "node:test";
import { GALLERY, launch, picture, settled, visit } from "../support.ts";

for (const width of [1280, 390]) {
  test(`frames are sorted, chosen and compared, ${width} pixels wide`, { skip: !GALLERY && "LSDC_GALLERY_URL is not set" }, async (t) => {
    const browser = await launch();
    t.after(() => browser.close());
    const { page, faults } = await visit(browser, "", { viewport: { width, height: 800 } }, GALLERY);
    await page.waitForSelector(".card");
    const cards = page.locator(".card");
    const all = await cards.count();
    assert.ok(all > 1);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= document.documentElement.clientWidth));
    await page.waitForFunction(() => [...document.querySelectorAll<HTMLImageElement>(".card img")].slice(0, 2).every((image) => image.complete));
    await picture(page, `gallery-${width}-light`);
    // Two named numbers, rather than a number and its uncertainty.
    const figures = await cards.first().locator(".figures > span").first().innerText();
    assert.match(figures, /^(leave-one-out [\d.]+ m\s+)?σ [\d.]+ m$/);
    await page.getByLabel("Sort by").selectOption("error");
    const errors = await cards.evaluateAll((cards) => cards.map((card) =>
      Math.max(-1, ...[...card.querySelectorAll(".figures > span > :first-child strong")].map((figure) => Number.parseFloat(figure.textContent!)))));
    assert.deepEqual(errors, [...errors].sort((a, b) => b - a));
    await page.locator(".gallery .segments input[value=failures]").check();
    assert.equal(await cards.count(), await page.locator(".card:has(.failed)").count() || 0);
    await page.locator(".gallery .segments input[value=all]").check();
    assert.equal(await cards.count(), all);

    await cards.first().click();
    await page.waitForSelector("dialog.wipe[open]");
    await page.waitForFunction(() => document.querySelector(".wipe .why")?.textContent?.includes("turbo"));
    const canvas = page.locator(".wipe canvas");
    const half = await canvas.screenshot();
    await page.locator(".wipe input[type=range]").focus();
    await page.keyboard.press("Home");
    const right = await canvas.screenshot();
    await page.keyboard.press("End");
    const left = await canvas.screenshot();
    assert.ok(!half.equals(right) && !half.equals(left) && !left.equals(right));
    const box = (await canvas.boundingBox())!;
    await page.mouse.click(box.x + box.width * 0.25, box.y + box.height / 2);
    assert.ok(Math.abs(Number(await page.locator(".wipe input[type=range]").inputValue()) - 250) < 5);
    await picture(page, `wipe-${width}-light`);
    const title = await page.locator(".wipe h2").textContent();
    await page.click('button[aria-label="Next frame"]');
    assert.notEqual(await page.locator(".wipe h2").textContent(), title);
    if (await page.locator("text=Open in the viewer").isVisible()) {
      await page.click("text=Open in the viewer");
      await page.waitForSelector('body[data-showing="work"]');
      await settled(page);
      await page.click(".top >> text=Gallery");
      await page.waitForSelector('body[data-showing="gallery"]');
    }
    assert.deepEqual(faults, []);
  });
}
