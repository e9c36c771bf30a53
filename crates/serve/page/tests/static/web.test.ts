// The page as static files. LSDC_WEB is the folder written by `npm run web -- FOLDER`, LSDC_REFERENCE the folder of native
// results written by the example `reference` of lsdc-c, and CHROMIUM the browser.

import assert from "node:assert/strict";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createServer, type Server } from "node:http";
import type { AddressInfo } from "node:net";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";
import { after, afterEach, before, beforeEach, test } from "node:test";
import type { Browser, Page } from "playwright-core";
import { read as readNpy } from "../../src/model/npy.ts";
import { count } from "../../src/model/numbers.ts";
import { read as readPng } from "../../src/browser/png.ts";
import { close, depthAt, launch, openDemo, openImage, picture, ROOM, rows, setDepth, settled, visit, type Visit } from "../support.ts";

const WEB = process.env.LSDC_WEB!;
const TYPES: Record<string, string> = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".wasm": "application/wasm" };
let server: Server;
let browser: Browser;
let at: Visit;
let page: Page;
let native: Float32Array;

async function map(path: string): Promise<Float32Array> {
  const bytes = await readFile(path);
  return readNpy(Uint8Array.from(bytes).buffer)!.values;
}

before(async () => {
  native = await map(join(process.env.LSDC_REFERENCE!, "depth.npy"));
  server = createServer((request, reply) => {
    const path = normalize(new URL(request.url!, "http://localhost").pathname);
    const file = path === "/" ? "/index.html" : path;
    readFile(join(WEB, file)).then(
      (bytes) => reply.writeHead(200, { "Content-Type": TYPES[extname(file)] ?? "application/octet-stream" }).end(bytes),
      () => reply.writeHead(404).end(),
    );
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  browser = await launch();
});
after(async () => {
  await browser.close();
  server.close();
});
beforeEach(async () => {
  at = await visit(browser, "", {}, `http://127.0.0.1:${(server.address() as AddressInfo).port}/`);
  page = at.page;
});
afterEach(async () => {
  assert.deepEqual(at.faults, []);
  await at.context.close();
});

/** Compares the page, which shows millimetres, with the native map. */
async function same(): Promise<void> {
  for (const [u, v] of [[100, 100], [200, 150], [20, 20], [290, 210]] as const) close(await depthAt(page, u, v), native[v * 304 + u]!, 0.0006);
}

test("the demo is completed as by the native library", async (t) => {
  const started = Date.now();
  await page.click(".demo");
  await page.waitForFunction(() => document.querySelector(".numbers .time")?.textContent?.startsWith("fit"));
  t.diagnostic(`first map after ${Date.now() - started} ms`);
  await settled(page);
  await same();
  t.diagnostic((await page.locator(".numbers .time").textContent())!);
  await picture(page, "static-1280-light");
});

test("the demo scenes are rendered from depths that are known", async () => {
  assert.deepEqual(await page.locator(".demo strong").allInnerTexts(),
    ["A rendered room, 500 depths", "A warehouse, sixteen beams of a laser scanner", "A desk, 48 depths"]);
  await picture(page, "static-start-1280-light");
  // Surfaces of demos.mjs: the end wall and the front of a box; a screen.
  const known: readonly [string, number, readonly [number, number, number][]][] =
    [["warehouse", 1616, [[170, 80, 19], [218, 170, 5.2]]], ["desk", 48, [[110, 110, 1.75], [150, 130, 1.75]]]];
  for (const [name, many, depths] of known) {
    await page.goto(new URL(`#demo=${name}`, page.url()).href);
    await page.reload();
    const used = `${count(many)} of ${count(many)}`;
    await page.waitForFunction((used) => document.querySelector(".settings")?.textContent?.includes(used), used);
    await settled(page);
    for (const [u, v, depth] of depths) close(await depthAt(page, u, v), depth, 0.03 * depth);
    await picture(page, `static-${name}-1280-light`);
  }
  await page.setViewportSize({ width: 390, height: 844 });
  await picture(page, "static-desk-390-light");
  await page.click(".mark");
  await picture(page, "static-start-390-light", true);
});

test("a program at the same address is used instead", async () => {
  await page.route("**/v1/start", (route) => route.fulfill({ json: { image: null } }));
  await page.route("**/v1/demo", (route) => route.fulfill({ json: [] }));
  await page.reload();
  await page.waitForFunction(() => document.querySelector(".start .why")?.textContent?.includes("EXR".toLowerCase()));
});

test("clicked depths make a map that goes through them", async (t) => {
  await openImage(page, join(ROOM, "rgb.png"));
  await page.waitForSelector('body[data-showing="work"]');
  const points: readonly [number, number, number][] = [[60, 190, 2.4], [150, 60, 6], [30, 100, 3.2], [250, 110, 6.5]];
  for (const point of points) await setDepth(page, ...point);
  await settled(page);
  for (const [u, v, depth] of points) close(await depthAt(page, u, v), depth, 0.005 * depth);
  t.diagnostic((await page.locator(".numbers .time").textContent())!);
});

test("own files are read, and what cannot be is named", async () => {
  const folder = await mkdtemp(join(tmpdir(), "lsdc-web-"));
  try {
    const sparse = await map(join(ROOM, "sparse.npy"));
    const known = [...sparse.keys()].filter((i) => sparse[i]! > 0);
    const lines = known.map((i) => `${i % 304},${Math.floor(i / 304)},${sparse[i]}`);
    await writeFile(join(folder, "points.csv"), ["u,v,depth", ...lines, "900,10,2", "10,10,nan", ""].join("\n"));
    await openImage(page, join(ROOM, "rgb.png"), join(folder, "points.csv"));
    await page.waitForFunction(() => document.querySelector(".settings")?.textContent?.includes("500 of 500"));
    await settled(page);
    await same();
    const remarks = await page.locator(".remarks").innerText();
    assert.match(remarks, /1 points have no depth[^]*1 points are outside/);

    await openImage(page, ["table.csv", "1,2,3\n4,five,6\n"]);
    const notice = page.locator(".notice");
    await notice.waitFor();
    assert.match(await notice.innerText(), /table\.csv.*line 2/);
    await openImage(page, ["cloud.ply", "ply\n"]);
    await page.waitForFunction(() => document.querySelector(".notice")?.textContent?.includes("cloud.ply"));
    assert.match(await notice.innerText(), /lsdc view/);
    await openImage(page, ["photo.jpg", "no picture"]);
    await page.waitForFunction(() => document.querySelector(".notice")?.textContent?.includes("photo.jpg"));
  } finally {
    await rm(folder, { recursive: true });
  }
});

/** Downloads the file of a row of the menu. */
async function taken(label: string): Promise<Buffer> {
  await page.click(".take summary");
  const [download] = await Promise.all([page.waitForEvent("download"), page.locator(".take .row", { hasText: label }).click()]);
  return readFile(await download.path());
}

test("downloads hold the map", async () => {
  await openDemo(page);
  const png = (await readPng(Uint8Array.from(await taken("PNG")).buffer))!;
  assert.deepEqual([png.width, png.height, png.perMetre], [304, 228, 1000]);
  png.values.forEach((value, i) => close(value / 1000, native[i]!, 0.00061));
  const ply = await taken("PLY");
  const end = ply.indexOf("end_header\n") + 11;
  const vertices = Number(/element vertex (\d+)/.exec(ply.toString("latin1", 0, end))![1]);
  assert.equal(ply.length, end + 19 * vertices);
  assert.ok(vertices > 0.9 * 304 * 228 && vertices <= 304 * 228);
  const report = JSON.parse((await taken("JSON")).toString("utf8"));
  assert.deepEqual(report.points, { given: 500, used: 500, ignored: 0, outside: 0, without_deviation: 0 });
  // The page reads a depth map that it wrote, with its unit, as points at all pixels with a depth.
  const few = png.values.map((value, i) => (i % 977 === 0 ? value : 0));
  const { write } = await import("../../src/browser/png.ts");
  const file = Buffer.from(await (await write({ ...png, values: few })).arrayBuffer());
  await openImage(page, ["depth.png", file]);
  await rows(page, few.filter((value) => value > 0).length);
  await settled(page);
});
