// The cloud, errors, narrow screens, themes and accessibility, with screenshots.

import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { join } from "node:path";
import { after, before, test } from "node:test";
import type { Browser, Page } from "playwright-core";
import { close, depthAt, launch, openDemo, openImage, picture, ROOM, settings, settled, slider, visit } from "../support.ts";

let browser: Browser;
before(async () => void (browser = await launch()));
after(() => browser.close());

const cloud = (page: Page): Promise<Buffer> => page.locator(".cloud canvas").screenshot();

test("the cloud turns, moves, and comes back", async () => {
  const { page, context, faults } = await visit(browser);
  await openDemo(page);
  const box = (await page.locator(".cloud .area").boundingBox())!;
  await page.mouse.move(box.x + 8, box.y + 8);
  const first = await cloud(page);
  const drag = async (modifier?: string) => {
    if (modifier) await page.keyboard.down(modifier);
    await page.mouse.move(box.x + 40, box.y + 30);
    await page.mouse.down();
    await page.mouse.move(box.x + 140, box.y + 60, { steps: 5 });
    await page.mouse.up();
    if (modifier) await page.keyboard.up(modifier);
  };
  await drag();
  const turned = (await settings(page, /orbit=/)).get("orbit")!.split(",").map(Number);
  close(turned[0]!, 0.3 - (100 / box.height) * 3, 0.002);
  close(turned[1]!, 0.24 + (30 / box.height) * 3, 0.002);
  assert.ok(!(await cloud(page)).equals(first));
  await drag("Shift");
  const moved = (await settings(page, /orbit=/)).get("orbit")!.split(",").map(Number);
  await page.waitForFunction((old) => !location.hash.includes(encodeURIComponent(old)), turned.join(","));
  assert.equal(moved[2], turned[2]);
  await page.mouse.wheel(0, -200);
  await page.locator(".cloud .area").focus();
  for (const key of ["ArrowLeft", "ArrowUp", "Shift+ArrowRight", "+"]) await page.keyboard.press(key);
  await page.click('button[aria-label="Reset the view"]');
  await page.mouse.move(box.x + 8, box.y + 8);
  await page.waitForFunction(() => !location.hash.includes("orbit"));
  assert.ok((await cloud(page)).equals(first));
  await slider(page, "Cut at a deviation").fill("30");
  assert.ok(!(await cloud(page)).equals(first));
  for (const source of ["depth", "deviation"]) {
    const before = await cloud(page);
    await page.locator(`.cloud .segments input[value=${source}]`).check();
    assert.ok(!(await cloud(page)).equals(before), source);
  }
  assert.deepEqual(faults, []);
  await context.close();
});

test("errors say what is wrong and what to do", async () => {
  const { page, context } = await visit(browser);
  const notice = page.locator(".notice");
  await openImage(page, ["holiday.jpg", "no picture"]);
  await notice.waitFor();
  assert.match(await notice.innerText(), /holiday\.jpg|image/i);
  assert.ok((await notice.locator(".hint").innerText()).length > 5, "no hint");
  await picture(page, "error-1280-light");
  await page.click('.notice button[aria-label="Close"]');
  await notice.waitFor({ state: "hidden" });
  await openImage(page, ["model.blend", "BLENDER"]);
  await page.waitForFunction(() => document.querySelector(".notice")?.textContent?.includes("model.blend"));
  await openImage(page, join(ROOM, "rgb.png"), ["points.csv", "these,are,no\nnumbers,at,all\n"]);
  await page.waitForFunction(() => document.querySelector(".notice.error:not([hidden])"));
  assert.match(await notice.innerText(), /points\.csv|number|line/i);
  assert.equal(await page.getAttribute("body", "data-showing"), "work");

  // The service goes away and returns.
  await page.click('.notice button[aria-label="Close"]');
  await page.route("**/complete", (route) => route.abort());
  await page.locator(".stage .area").focus();
  await page.keyboard.press("Enter");
  await page.keyboard.type("3");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.querySelector(".notice")?.textContent?.includes("does not answer"));
  await page.unroute("**/complete");
  await page.getByRole("button", { name: "Try again" }).click();
  await settled(page);
  close(await depthAt(page, 152, 114), 3, 0.01);

  // An expired image is posted again without a notice.
  let refused = 0;
  await page.route("**/complete", (route) => refused++ === 0
    ? route.fulfill({ status: 404, contentType: "application/json", body: JSON.stringify({ error: { message: "no such scene", hint: "post the image again", request: "1" } }) })
    : route.continue());
  await page.locator(".stage .area").focus();
  await page.keyboard.press("n");
  await page.keyboard.press("Enter");
  await page.keyboard.type("2.5");
  await page.keyboard.press("Enter");
  await settled(page);
  close(await depthAt(page, 152, 114), 2.5, 0.01);
  assert.ok(await notice.isHidden());
  await context.close();
});

const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");

async function accessible(page: Page, where: string): Promise<void> {
  // The page's content policy forbids foreign scripts, so the script is evaluated from outside.
  const source = await (await import("node:fs/promises")).readFile(axe, "utf8");
  await page.evaluate(source);
  const violations = await page.evaluate(async () => {
    const { violations } = await (window as unknown as { axe: { run(options: object): Promise<{ violations: { id: string; nodes: { html: string; failureSummary: string }[] }[] }> } })
      .axe.run({ runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"] });
    return violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html, failureSummary }) => `${html.slice(0, 160)} ${failureSummary.slice(0, 200)}`).join(" | ")}`);
  });
  assert.deepEqual(violations, [], where);
}

for (const width of [1280, 390]) {
  for (const colorScheme of ["light", "dark"] as const) {
    test(`${width} pixels wide, ${colorScheme}`, async () => {
      const narrow = width === 390;
      const { page, context, faults } = await visit(browser, "", {
        viewport: { width, height: narrow ? 844 : 800 }, colorScheme, hasTouch: narrow, isMobile: narrow, deviceScaleFactor: 2,
      });
      await page.waitForSelector(".demo img");
      await picture(page, `start-${width}-${colorScheme}`);
      await accessible(page, "start");
      await openDemo(page);
      const fits = () => page.evaluate(() => document.documentElement.scrollWidth <= document.documentElement.clientWidth);
      assert.ok(await fits(), "the page is wider than the screen");
      if (!narrow) {
        const beyond = await page.evaluate(() => document.documentElement.scrollHeight - document.documentElement.clientHeight);
        assert.equal(beyond, 0, "the page is higher than the screen");
      }
      await picture(page, `work-${width}-${colorScheme}`, narrow);
      await accessible(page, "work");
      const box = (await page.locator(".stage .area").boundingBox())!;
      const [x, y] = [box.x + 0.3 * box.width, box.y + 0.2 * box.height];
      if (narrow) await page.touchscreen.tap(x, y);
      else await page.mouse.click(x, y);
      await page.waitForSelector(".editor");
      await settled(page);
      const editor = (await page.locator(".editor").boundingBox())!;
      assert.ok(editor.x >= 0 && editor.x + editor.width <= width, "the editor is cut off");
      await picture(page, `editor-${width}-${colorScheme}`);
      await accessible(page, "editor");
      await page.keyboard.press("Enter");
      await page.click("summary");
      const sheet = (await page.locator(".sheet").boundingBox())!;
      assert.ok(sheet.x >= 0 && sheet.x + sheet.width <= width, "the menu is cut off");
      await picture(page, `download-${width}-${colorScheme}`);
      await accessible(page, "download");
      await page.keyboard.press("Escape");
      await page.click('button[aria-label="Light or dark"]');
      await page.waitForFunction((paper) => getComputedStyle(document.querySelector(".top")!).backgroundColor === paper,
        colorScheme === "dark" ? "rgb(255, 255, 255)" : "rgb(22, 25, 29)");
      assert.deepEqual(faults, []);
      await context.close();
    });
  }
}

test("two fingers magnify the map, one scrolls the page", async () => {
  const { page, context } = await visit(browser, "", { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  await openDemo(page);
  const box = (await page.locator(".stage .area").boundingBox())!;
  const session = await context.newCDPSession(page);
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...points: [number, number][]) =>
    session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x: box.x + x, y: box.y + y, id })) });
  const before = await page.locator(".stage canvas").screenshot();
  await touch("touchStart", [150, 150], [200, 150]);
  for (let i = 1; i <= 5; i++) await touch("touchMove", [150 - 10 * i, 150], [200 + 10 * i, 150]);
  await touch("touchEnd");
  assert.ok(!(await page.locator(".stage canvas").screenshot()).equals(before));
  assert.ok(await page.locator(".editor").isHidden());
  await context.close();
});
