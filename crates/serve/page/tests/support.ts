// A browser for the tests. LSDC_VIEW_URL is the address that `lsdc view` prints, LSDC_GALLERY_URL that of one with a results
// folder, CHROMIUM the browser, and LSDC_SCREENSHOTS a folder for screenshots.

import assert from "node:assert/strict";
import { mkdirSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { chromium, type Browser, type BrowserContext, type BrowserContextOptions, type Locator, type Page } from "playwright-core";

export const VIEW = process.env.LSDC_VIEW_URL ?? "";
export const GALLERY = process.env.LSDC_GALLERY_URL ?? "";
export const ROOM = process.env.LSDC_ROOM ?? join(process.cwd(), "../../../assets/room");
const PICTURES = process.env.LSDC_SCREENSHOTS ?? join(tmpdir(), "lsdc-page");

export const launch = (): Promise<Browser> =>
  chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: [
      "--no-sandbox",
      // No graphics card is needed: WebGL runs in software, everything else without WebGL.
      "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing", "--disable-accelerated-2d-canvas",
      "--disable-background-networking", "--disable-component-update", "--disable-sync",
    ],
  });

export interface Visit {
  readonly page: Page;
  readonly context: BrowserContext;
  /** Uncaught errors of the page, and errors logged to the console. */
  readonly faults: string[];
}

/** Opens a page in a new context, with the cookie that the printed address sets. */
export async function visit(browser: Browser, fragment = "", options: BrowserContextOptions = {}, address = VIEW): Promise<Visit> {
  if (!address) throw new Error("LSDC_VIEW_URL is not set: the address that `lsdc view` prints");
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true, ...options });
  const page = await context.newPage();
  const faults: string[] = [];
  page.on("pageerror", (error) => faults.push(String(error)));
  page.on("console", (message) => message.type() === "error" && faults.push(message.text()));
  await page.goto(address);
  if (fragment) {
    await page.goto(`${new URL(page.url()).origin}/#${fragment}`);
    await page.reload();
  }
  await page.waitForSelector(".demo, .card, body[data-showing=work]", { state: "attached" });
  return { page, context, faults };
}

/** Waits until all results of the current points, slow ones included, are shown. */
export async function settled(page: Page): Promise<void> {
  // An action takes effect in the next frame.
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  await page.waitForSelector('body[data-showing="work"][data-fitting="false"]', { timeout: 90_000 });
}

export const slider = (page: Page, name: string): Locator => page.getByRole("slider", { name });

export async function openDemo(page: Page): Promise<void> {
  await page.click(".demo");
  await page.waitForFunction(() => document.querySelector(".numbers dd")?.textContent?.includes("m"));
  await settled(page);
}

/** Opens files by their paths, or by names and contents. */
export async function openImage(page: Page, ...files: (string | readonly [name: string, contents: string | Buffer])[]): Promise<void> {
  const payload = files.map((file) => typeof file === "string"
    ? { name: basename(file), mimeType: "image/png", buffer: readFileSync(file) }
    : { name: file[0], mimeType: "application/octet-stream", buffer: typeof file[1] === "string" ? Buffer.from(file[1]) : file[1] });
  await page.locator('input[aria-label="Open an image, and its points"]').first().setInputFiles(payload);
}

/** Position of an image pixel on the screen, on a stage that is not magnified. */
export async function place(page: Page, u: number, v: number, [columns, rows] = [304, 228]): Promise<{ x: number; y: number }> {
  const box = (await page.locator(".stage .area").boundingBox())!;
  const scale = Math.min(box.width / columns!, box.height / rows!);
  return {
    x: box.x + (box.width - columns! * scale) / 2 + (u + 0.5) * scale,
    y: box.y + (box.height - rows! * scale) / 2 + (v + 0.5) * scale,
  };
}

/** Depth shown at a pixel, in metres. */
export async function depthAt(page: Page, u: number, v: number): Promise<number> {
  const { x, y } = await place(page, u, v);
  await page.mouse.move(x, y);
  await page.waitForFunction(([u, v]) => document.querySelector(".readout .place")?.textContent === `u ${u}  v ${v}`, [u, v]);
  return Number.parseFloat((await page.locator(".readout .value").textContent())!);
}

/** Clicks a pixel and types its depth. */
export async function setDepth(page: Page, u: number, v: number, depth: number): Promise<void> {
  const { x, y } = await place(page, u, v);
  await page.mouse.click(x, y);
  await page.locator(".editor input[type=number]").fill(String(depth));
  await page.keyboard.press("Enter");
  await page.waitForSelector(".editor", { state: "hidden" });
}

/** Waits until the table has `many` points. */
export const rows = (page: Page, many: number): Promise<unknown> =>
  page.waitForFunction((many) => document.querySelectorAll(".list tbody tr").length === many, many);

/** Waits until the fragment of the address matches, and returns its settings. */
export async function settings(page: Page, has: RegExp = /#./): Promise<URLSearchParams> {
  await page.waitForURL((url) => has.test(url.hash));
  return new URLSearchParams(new URL(page.url()).hash.slice(1));
}

export async function picture(page: Page, name: string, fullPage = false): Promise<void> {
  mkdirSync(PICTURES, { recursive: true });
  await page.screenshot({ path: join(PICTURES, `${name}.png`), fullPage });
}

export function close(value: number, expected: number, tolerance: number): void {
  assert.ok(Math.abs(value - expected) <= tolerance, `${value} instead of ${expected} ± ${tolerance}`);
}
