// The package in Chromium, served as static files. CHROMIUM is the browser.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { chromium } from "playwright-core";
import { image, largestDifference, native, npm, points } from "./support.mjs";

const TYPES = { ".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html" };
let server;
let browser;
let page;

before(async () => {
  server = createServer(async ({ url }, reply) => {
    const path = normalize(new URL(url, "http://localhost").pathname);
    try {
      const bytes = path === "/" ? "<!doctype html><title>lsdc</title>" : await readFile(join(npm, "dist", path));
      reply.writeHead(200, { "Content-Type": path === "/" ? "text/html" : (TYPES[extname(path)] ?? "application/octet-stream") }).end(bytes);
    } catch {
      reply.writeHead(404).end();
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
  page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
});

after(async () => {
  await browser?.close();
  server?.close();
});

test("a worker completes a canvas as the native library does, and refits it", async (t) => {
  const { width, height, data } = image();
  const found = await page.evaluate(async ({ width, height, data, points }) => {
    const { Completer } = await import("/worker.js");
    const rgba = new ImageData(width, height);
    for (let i = 0; i < width * height; i++) {
      for (let c = 0; c < 3; c++) rgba.data[4 * i + c] = data[3 * i + c];
      rgba.data[4 * i + 3] = 255;
    }
    const canvas = document.createElement("canvas");
    Object.assign(canvas, { width, height }).getContext("2d").putImageData(rgba, 0, 0);
    const times = {};
    const timed = async (name, work) => {
      const started = performance.now();
      const result = await work();
      times[name] = Math.round(performance.now() - started);
      return result;
    };
    const known = Float32Array.from(points);
    const completer = await timed("load", () => Completer.load());
    const scene = await timed("scene", () => completer.scene(canvas));
    const quick = { deviations: false, outliers: false };
    const { depth } = await timed("first fit", () => scene.complete(known, quick));
    for (let i = 1; i <= 4; i++) await timed(`refit ${i}`, () => scene.complete(known.subarray(0, 3 * (500 - i)), quick));
    const all = await timed("all outputs", () => scene.complete(known));
    const none = await scene.complete([]).catch(({ name, kind, message, hint }) => ({ name, kind, message, hint }));
    scene.free();
    const freed = await scene.complete(known).catch(({ kind }) => kind);
    completer.free();
    const ended = await completer.scene(canvas).catch(({ kind }) => kind);
    return { depth: [...depth], again: all.depth.every((value, i) => value === depth[i]), report: all.report, none, freed, ended, times };
  }, { width, height, data: [...data], points: [...points()] });
  t.diagnostic(`milliseconds: ${JSON.stringify(found.times)}`);
  assert.ok(largestDifference(found.depth, native("depth")) < 1e-4);
  assert.ok(found.again);
  assert.equal(found.report.points.used, 500);
  assert.equal(found.none.name, "LsdcError");
  assert.equal(found.none.kind, "fit");
  assert.match(found.none.hint, /at least one/);
  assert.deepEqual([found.freed, found.ended], ["use", "use"]);
});

test("an address without weights rejects", async () => {
  const error = await page.evaluate(async () => {
    const { Completer } = await import("/worker.js");
    return Completer.load({ weights: new URL("/none.safetensors", location.href) }).catch(({ kind, message }) => ({ kind, message }));
  });
  assert.equal(error.kind, "load");
  assert.match(error.message, /status 404/);
});
