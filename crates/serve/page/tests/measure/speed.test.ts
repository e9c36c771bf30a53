// Not a test: measures maps per second while a point is dragged at 640x480, and where the time is spent. Run it on a quiet
// machine: `node tests/run.mjs measure`. LSDC_FRAME is another image.

import { test } from "node:test";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { launch, picture, ROOM, settled, visit } from "../support.ts";

const SECONDS = 6;

test("maps a second", async (report) => {
  const browser = await launch();
  report.after(() => browser.close());
  const { page } = await visit(browser);
  const image = readFileSync(process.env.LSDC_FRAME ?? join(ROOM, "rgb.png")).toString("base64");
  const frame = await page.evaluate(async (image) => {
    const bytes = Uint8Array.from(atob(image), (letter) => letter.charCodeAt(0));
    const canvas = new OffscreenCanvas(640, 480);
    canvas.getContext("2d")!.drawImage(await createImageBitmap(new Blob([bytes])), 0, 0, 640, 480);
    const png = new Uint8Array(await (await canvas.convertToBlob()).arrayBuffer());
    return Array.from(png, (byte) => String.fromCharCode(byte)).join("");
  }, image);
  for (const [many, without] of [[5, ""], [50, ""], [500, ""], [500, " without the cloud"]] as const) {
    await page.evaluate((hidden) => (document.querySelector<HTMLElement>(".cloud .area")!.style.display = hidden ? "none" : ""), without !== "");
    let seed = 1;
    const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
    const lines = Array.from({ length: many }, () => {
      const [u, v] = [20 + 600 * random(), 20 + 440 * random()];
      return `${u.toFixed(1)},${v.toFixed(1)},${(3 + Math.sin(u / 100) + v / 240).toFixed(3)}`;
    });
    const buffer = Buffer.from(frame, "latin1");
    await page.locator('input[aria-label="Open an image, and its points"]').first().setInputFiles([
      { name: `${many}${without}.png`, mimeType: "image/png", buffer },
      { name: "points.csv", mimeType: "text/csv", buffer: Buffer.from(["u,v,depth", ...lines, ""].join("\n")) },
    ]);
    await page.waitForFunction((name) => document.querySelector(".scene")?.textContent?.startsWith(name), `${many}${without}.png`);
    await page.waitForFunction((many) => document.querySelectorAll(".list tbody tr").length === Math.min(200, many), many);
    await settled(page);
    const [u, v] = lines[0]!.split(",").map(Number);
    const box = (await page.locator(".stage .area").boundingBox())!;
    const scale = Math.min(box.width / 640, box.height / 480);
    const at = { x: box.x + (box.width - 640 * scale) / 2 + (u! + 0.5) * scale, y: box.y + (box.height - 480 * scale) / 2 + (v! + 0.5) * scale };
    await page.evaluate(() => {
      performance.clearResourceTimings();
      performance.setResourceTimingBufferSize(5000);
      const counter = window as unknown as { frames: number; counting?: number };
      cancelAnimationFrame(counter.counting ?? 0);
      counter.frames = 0;
      const count = () => (counter.frames++, counter.counting = requestAnimationFrame(count));
      count();
    });
    await page.mouse.move(at.x, at.y);
    await page.mouse.down();
    const start = Date.now();
    for (let i = 0; Date.now() - start < 1000 * SECONDS; i++) {
      await page.mouse.move(at.x + 20 * Math.sin(i / 20), at.y + 20 * Math.sin(i / 33));
    }
    const seconds = (Date.now() - start) / 1000;
    const { durations, frames } = await page.evaluate(() => ({
      durations: performance.getEntriesByType("resource").filter(({ name }) => name.endsWith("/complete")).map(({ duration }) => duration),
      frames: (window as unknown as { frames: number }).frames,
    }));
    await page.mouse.up();
    durations.sort((a, b) => a - b);
    report.diagnostic(`${many} points${without}: ${(durations.length / seconds).toFixed(1)} maps/s, ${(frames / seconds).toFixed(0)} frames/s, ` +
      `request ${durations[durations.length >> 1]?.toFixed(0)} ms (median), ${durations[Math.floor(0.9 * durations.length)]?.toFixed(0)} ms (9 of 10); ` +
      (await page.locator(".time").textContent()));
    await settled(page);
  }
  await picture(page, "speed-1280-light");
});
