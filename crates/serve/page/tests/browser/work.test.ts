// Points, map, undo, subsets, files and links, against the service.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { copyFile, mkdtemp, readdir, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, afterEach, before, beforeEach, test } from "node:test";
import type { Browser, Page } from "playwright-core";
import { close, depthAt, launch, openDemo, openImage, picture, place, ROOM, rows, setDepth, settings, settled, slider, visit, type Visit } from "../support.ts";

let browser: Browser;
let at: Visit;
let page: Page;
before(async () => void (browser = await launch()));
after(() => browser.close());
beforeEach(async () => {
  at = await visit(browser);
  page = at.page;
});
afterEach(async () => {
  assert.deepEqual(at.faults, []);
  await at.context.close();
});

const FIVE: readonly [number, number, number][] = [[60, 190, 2.4], [150, 60, 6], [30, 100, 3.2], [250, 110, 6.5], [160, 200, 3]];

/** Depths at pixels of the map that the service returns for points, without the page. */
const served = (points: readonly (readonly number[])[], pixels: readonly (readonly [number, number])[]): Promise<number[]> =>
  page.evaluate(async ([points, pixels]) => {
    const image = await (await fetch((await (await fetch("v1/demo")).json())[0].image)).blob();
    const body = new FormData();
    body.set("image", image, "rgb.png");
    const { id } = await (await fetch("v1/scenes", { method: "POST", body })).json();
    const reply = await fetch(`v1/scenes/${id}/complete`, {
      method: "POST", body: JSON.stringify({ points }), headers: { "Content-Type": "application/json", Accept: "application/vnd.lsdc.layers" },
    });
    const bytes = await reply.arrayBuffer();
    const start = 4 + new DataView(bytes).getUint32(0, true);
    const { width, layers } = JSON.parse(new TextDecoder().decode(bytes.slice(4, start)));
    const map = new Float32Array(bytes, start + layers.find((layer: { name: string }) => layer.name === "depth").offset);
    return pixels.map(([u, v]) => map[v * width + u]!);
  }, [points, pixels] as const);

test("five clicked depths make a map, and a sixth changes it by the right amount", async () => {
  await openImage(page, join(ROOM, "rgb.png"));
  await page.waitForSelector('body[data-showing="work"]');
  for (const point of FIVE) await setDepth(page, ...point);
  await settled(page);
  for (const [u, v, depth] of FIVE) close(await depthAt(page, u, v), depth, 0.005 * depth);
  await rows(page, 5);
  const pixels = [[100, 100], [200, 150], [20, 20], [290, 210]] as const;
  const before = await served(FIVE, pixels);
  for (const [i, [u, v]] of pixels.entries()) close(await depthAt(page, u, v), before[i]!, 0.001);

  const sixth = [200, 150, before[1]! * 0.7] as const;
  await setDepth(page, ...sixth);
  await settled(page);
  const now = await served([...FIVE, [200, 150, Number(sixth[2].toPrecision(17))]], pixels);
  for (const [i, [u, v]] of pixels.entries()) close(await depthAt(page, u, v), now[i]!, 0.001);
  close(await depthAt(page, 200, 150), sixth[2], 0.01);
  await picture(page, "clicked-1280-light");
});

test("the map follows while a depth is pulled, and all of it is one undo", async () => {
  await openDemo(page);
  const { x, y } = await place(page, 235, 195);
  const old = await depthAt(page, 235, 195);
  const input = page.locator(".editor input[type=number]");
  const pull = async () => {
    await page.locator(".editor input[type=range]").focus();
    for (let i = 0; i < 30; i++) await page.keyboard.press("ArrowRight");
  };
  await page.mouse.click(x, y);
  await pull();
  const typed = Number(await input.inputValue());
  close(typed, old * 2 ** (60 / 400), 0.002 * old);
  await page.keyboard.press("Enter");
  await settled(page);
  close(await depthAt(page, 235, 195), typed, 0.02 * typed);
  // The map follows an existing point at once.
  await page.mouse.click(x, y);
  await pull();
  await settled(page);
  const farther = Number(await input.inputValue());
  close(farther, typed * 2 ** (60 / 400), 0.002 * typed);
  close(await depthAt(page, 235, 195), farther, 0.02 * farther);
  await page.keyboard.press("Escape");
  await page.click('button[aria-label="Undo"]');
  await settled(page);
  close(await depthAt(page, 235, 195), typed, 0.02 * typed);
  await page.click('button[aria-label="Undo"]');
  await settled(page);
  close(await depthAt(page, 235, 195), old, 0.001);
  await page.keyboard.press("Control+Shift+Z");
  await page.keyboard.press("Control+Y");
  await settled(page);
  close(await depthAt(page, 235, 195), farther, 0.02 * farther);
});

test("a click is no measurement until its depth is accepted", async () => {
  await openDemo(page);
  const figures = async () => (await page.locator(".numbers dl").innerText()) + (await page.locator(".slider", { hasText: "Points used" }).innerText());
  const before = await figures();
  const old = await depthAt(page, 235, 195);
  const { x, y } = await place(page, 235, 195);
  const other = await place(page, 40, 40);
  const editor = page.locator(".editor");
  const unchanged = async (why: string) => {
    await settled(page);
    assert.equal(await figures(), before, why);
    assert.ok(await page.locator('button[aria-label="Undo"]').isDisabled(), `${why}: something can be undone`);
  };
  await page.mouse.click(x, y);
  await editor.waitFor();
  assert.equal(await editor.locator("input[type=number]").inputValue(), "");
  await unchanged("a click");
  await page.keyboard.type("7.5");
  await picture(page, "pending-1280-light");
  await unchanged("typing");
  await page.keyboard.press("Escape");
  await editor.waitFor({ state: "hidden" });
  await unchanged("Escape");
  for (const text of ["", "0", "-2"]) {
    await page.mouse.click(x, y);
    await editor.waitFor();
    await page.keyboard.type(text);
    await page.keyboard.press("Enter");
    await editor.waitFor({ state: "hidden" });
    await unchanged(`"${text}" and Enter`);
  }
  // Elsewhere: another place in the image is another new point, the settings are none.
  await page.mouse.click(x, y);
  await page.keyboard.type("7.5");
  await page.mouse.click(other.x, other.y);
  await page.waitForFunction(() => document.querySelector(".editor .title")?.textContent?.includes("u 40 v 40"));
  assert.equal(await editor.locator("input[type=number]").inputValue(), "");
  await page.locator("aside h2").first().click();
  await editor.waitFor({ state: "hidden" });
  await unchanged("a click elsewhere");
  // After an accepted point, undo and redo do not bring back any of this.
  await setDepth(page, 235, 195, 1.2 * old);
  await settled(page);
  close(await depthAt(page, 235, 195), 1.2 * old, 0.02 * old);
  await page.mouse.click(other.x, other.y);
  await page.keyboard.type("3");
  await page.keyboard.press("Escape");
  await page.keyboard.press("Control+Z");
  await unchanged("undo");
  await page.keyboard.press("Control+Shift+Z");
  await settled(page);
  assert.match(await page.locator(".slider", { hasText: "Points used" }).innerText(), /501 of 501/);
  assert.ok(await page.locator('button[aria-label="Redo"]').isDisabled());
});

test("another image has a cut and a view of its own, and a cloud that is empty says why", async () => {
  await openDemo(page);
  const why = page.locator(".cloud .missing");
  assert.ok(await why.isHidden());
  await slider(page, "Cut at a deviation").fill("1");
  await page.waitForFunction(() => document.querySelector(".cloud .missing:not([hidden])")?.textContent?.includes("above the cut"));
  await picture(page, "cut-1280-light");
  await slider(page, "Cut at a deviation").fill("100");
  await why.waitFor({ state: "hidden" });
  const box = (await page.locator(".cloud .area").boundingBox())!;
  await page.mouse.move(box.x + 40, box.y + 30);
  await page.keyboard.down("Shift");
  await page.mouse.down();
  await page.mouse.move(box.x + 40, box.y + 30 + 4 * box.height, { steps: 4 });
  await page.mouse.up();
  await page.keyboard.up("Shift");
  await page.waitForFunction(() => document.querySelector(".cloud .missing:not([hidden])")?.textContent?.includes("out of sight"));
  await slider(page, "Cut at a deviation").fill("30");
  await page.getByLabel("Leave out flying pixels").uncheck();
  await settings(page, /cut=.*flying=yes/);
  await openImage(page, join(ROOM, "rgb.png"));
  // Wait until the demo's points are gone: a click before that would hit the demo.
  await rows(page, 0);
  await setDepth(page, 100, 100, 3);
  await settled(page);
  const fields = await settings(page, /image=rgb/);
  assert.deepEqual(["cut", "orbit", "flying"].map((name) => fields.get(name)), [null, null, null]);
  assert.ok(await why.isHidden());
});

test("flying pixels are left out of the cloud, and counted", async () => {
  await openDemo(page);
  const note = page.locator(".cloud .check .amount").first();
  const share = Number.parseFloat((await note.textContent())!);
  assert.ok(share > 0.2 && share < 20, `${share} %`);
  await page.mouse.move(5, 5);
  const without = await page.locator(".cloud canvas").screenshot();
  await page.getByLabel("Leave out flying pixels").uncheck();
  await page.waitForFunction(() => document.querySelector(".cloud .check .amount")?.textContent === "");
  assert.ok(!(await page.locator(".cloud canvas").screenshot()).equals(without));
});

test("the command of a cloud works when it is pasted", { skip: !process.env.LSDC_PROGRAM && "LSDC_PROGRAM is not set" }, async () => {
  await openDemo(page);
  await setDepth(page, 235, 195, 4);
  await slider(page, "Cut at a deviation").fill("60");
  await settled(page);
  const folder = await mkdtemp(join(tmpdir(), "lsdc-command-"));
  const [table] = await Promise.all([page.waitForEvent("download"), page.click("text=Save CSV")]);
  await table.saveAs(join(folder, table.suggestedFilename()));
  await copyFile(join(ROOM, "rgb.png"), join(folder, "rgb.png"));
  await page.click("summary");
  const line = (await page.locator(".command code").textContent())!;
  const path = `${dirname(process.env.LSDC_PROGRAM!)}:${process.env.PATH}`;
  const { status, stderr } = spawnSync("sh", ["-c", line], { cwd: folder, env: { ...process.env, PATH: path }, encoding: "utf8" });
  assert.equal(status, 0, `${line}\n${stderr}`);
  const files = await readdir(folder, { recursive: true });
  assert.ok(files.some((name) => name.endsWith(".ply")), files.join());
  await rm(folder, { recursive: true });
});

test("the table has all points", async () => {
  await openDemo(page);
  await rows(page, 200);
  await page.getByRole("button", { name: "Show 300 more" }).click();
  await rows(page, 500);
  assert.ok(await page.getByRole("button", { name: /more$/ }).isHidden());
});

test("a map that takes long is said to be computed, and the old one pales", async () => {
  await openDemo(page);
  const busy = page.locator(".busy");
  let let_on = () => undefined as void;
  const held = new Promise<void>((resolve) => (let_on = resolve));
  await page.route("**/complete", async (route) => {
    await held;
    await route.continue();
  });
  await setDepth(page, 40, 40, 2.9);
  await busy.waitFor();
  assert.match((await busy.textContent())!, /Computing the map/);
  assert.equal(await page.getAttribute("body", "data-old"), "true");
  await picture(page, "busy-1280-light");
  let_on();
  await settled(page);
  await busy.waitFor({ state: "hidden" });
  assert.equal(await page.getAttribute("body", "data-old"), "false");
});

test("after a reload, no other image takes the place of one's own", async () => {
  await openImage(page, join(ROOM, "rgb.png"));
  await page.waitForSelector('body[data-showing="work"]');
  await setDepth(page, 150, 60, 6);
  await settled(page);
  const before = await settings(page, /points=/);
  await page.reload();
  await page.waitForFunction(() => document.querySelector(".notice")?.textContent?.includes("rgb.png"));
  assert.equal(await page.getAttribute("body", "data-showing"), "start");
  await openImage(page, join(ROOM, "rgb.png"));
  await settled(page);
  await rows(page, 1);
  assert.equal((await settings(page, /points=/)).toString(), before.toString());
});

test("what was assumed is said", async () => {
  await openImage(page, join(ROOM, "rgb.png"), ["camera.toml", "fx = 260\nfy = 260\ncx = 2000\ncy = 113.5\n"]);
  await page.waitForSelector('body[data-showing="work"]');
  await setDepth(page, 150, 60, 6);
  await settled(page);
  assert.match(await page.locator(".remarks").innerText(), /principal point/);
});

test("a point is dragged, removed, and brought back", async () => {
  await openImage(page, join(ROOM, "rgb.png"));
  await page.waitForSelector('body[data-showing="work"]');
  for (const point of FIVE) await setDepth(page, ...point);
  const from = await place(page, 150, 60);
  const to = await place(page, 120, 80);
  await page.mouse.move(from.x, from.y);
  await page.mouse.down();
  for (let i = 1; i <= 8; i++) await page.mouse.move(from.x + ((to.x - from.x) * i) / 8, from.y + ((to.y - from.y) * i) / 8);
  await page.mouse.up();
  await settled(page);
  close(await depthAt(page, 120, 80), 6, 0.03);
  await page.locator(".stage .area").focus();
  await page.keyboard.press("Delete");
  await rows(page, 4);
  await page.keyboard.press("Control+Z");
  await rows(page, 5);
  await page.keyboard.press("Control+Z");
  await settled(page);
  close(await depthAt(page, 150, 60), 6, 0.03);
});

test("fewer points: the errors at those left out are measured", async () => {
  await openDemo(page);
  const figure = (i: number) => page.locator(".numbers dd").nth(i).textContent();
  assert.equal(await figure(3), "–");
  await slider(page, "Points used").fill("90");
  await settled(page);
  assert.match((await page.locator(".slider", { hasText: "Points used" }).locator(".amount").textContent())!, /^16 of 500$/);
  const few = Number.parseFloat((await figure(3))!);
  await slider(page, "Points used").fill("160");
  await settled(page);
  const more = Number.parseFloat((await figure(3))!);
  assert.ok(few > more && more > 0.05, `${few} with 16, ${more} with 144`);
});

test("a wrong point is found by the others", async () => {
  await openDemo(page);
  await page.getByLabel("Robust").selectOption("auto");
  await setDepth(page, 235, 195, 9.5);
  await settled(page);
  assert.equal(await page.locator(".numbers dd").nth(4).textContent(), "1");
  assert.ok((await depthAt(page, 235, 195)) < 4.5);
  await page.getByLabel("Colour by").selectOption("outlier");
  await picture(page, "outlier-1280-light");
});

test("downloads are the files of the service", async () => {
  await openDemo(page);
  const bytes = async (label: string) => {
    await page.click("summary");
    const [download] = await Promise.all([page.waitForEvent("download"), page.click(`.sheet .row:has-text("${label}")`)]);
    return { name: download.suggestedFilename(), contents: await readFile(await download.path()) };
  };
  const direct = (type: string) => page.evaluate(async (type) => {
    const [demo] = await (await fetch("v1/demo")).json();
    const body = new FormData();
    body.set("image", await (await fetch(demo.image)).blob(), "rgb.png");
    const given = typeof demo.points === "string" ? await (await fetch(demo.points)).blob() : new Blob([JSON.stringify(demo.points)]);
    body.set("points", given, typeof demo.points === "string" ? demo.points.split("/").pop() : "points.json");
    const reply = await fetch("v1/complete", { method: "POST", body, headers: { Accept: type } });
    return [...new Uint8Array(await reply.arrayBuffer())];
  }, type);
  const png = await bytes("PNG");
  assert.equal(png.name, "rgb_depth.png");
  assert.deepEqual([...png.contents.subarray(1, 4)], [...Buffer.from("PNG")]);
  assert.ok(png.contents.equals(Buffer.from(await direct("image/png"))), "the PNG differs from that of the service");
  const exr = await bytes("EXR");
  assert.ok(exr.contents.equals(Buffer.from(await direct("image/x-exr"))), "the EXR differs from that of the service");
  const npz = await bytes("NPZ");
  assert.equal(npz.contents.subarray(0, 2).toString(), "PK");
  const ply = await bytes("PLY");
  assert.equal(ply.contents.subarray(0, 3).toString(), "ply");
  const json = JSON.parse((await bytes("JSON")).contents.toString());
  assert.equal(json.points.used, 500);
  const [table] = await Promise.all([page.waitForEvent("download"), page.click("text=Save CSV")]);
  const lines = (await readFile(await table.path(), "utf8")).trim().split("\n");
  assert.deepEqual([lines.length, lines[0]], [501, "u,v,depth"]);
});

test("a link holds all settings", async () => {
  await openDemo(page);
  await page.getByLabel("Robust").selectOption("huber");
  await page.getByLabel("Colour by").selectOption("deviation");
  await slider(page, "Points used").fill("120");
  await page.locator(".image .segments input[value=deviation]").check();
  await slider(page, "Opacity of the map").fill("55");
  await slider(page, "Cut at a deviation").fill("60");
  await setDepth(page, 40, 40, 2.9);
  await settled(page);
  const fields = await settings(page, /points=.*/);
  assert.deepEqual([fields.get("demo"), fields.get("robust"), fields.get("marks"), fields.get("layer"), fields.get("opacity")], ["room", "huber", "deviation", "deviation", "0.55"]);
  const figures = await page.locator(".numbers dl").innerText();
  const again = await visit(browser, new URL(page.url()).hash.slice(1));
  await settled(again.page);
  await again.page.waitForFunction((figures) => (document.querySelector(".numbers dl") as HTMLElement).innerText === figures, figures);
  assert.equal((await settings(again.page)).toString(), fields.toString());
  assert.equal(await again.page.getByLabel("Robust").inputValue(), "huber");
  await again.context.close();
});

test("with the keyboard alone", async () => {
  await openImage(page, join(ROOM, "rgb.png"));
  await page.waitForSelector('body[data-showing="work"]');
  let tabs = 0;
  while (!(await page.evaluate(() => document.activeElement?.matches(".stage .area"))) && tabs++ < 30) await page.keyboard.press("Tab");
  assert.ok(tabs < 30, "the image cannot be reached");
  const focus = () => page.evaluate(() => document.querySelector(".readout .place")?.textContent);
  await page.waitForFunction(() => document.querySelector(".readout .place")?.textContent === "u 152  v 114");
  for (const key of ["Shift+ArrowLeft", "ArrowUp", "Shift+ArrowUp", "ArrowRight"]) await page.keyboard.press(key);
  await page.waitForFunction(() => document.querySelector(".readout .place")?.textContent === "u 143  v 103");
  await page.keyboard.press("Enter");
  await page.keyboard.type("4.5");
  await page.keyboard.press("Enter");
  await settled(page);
  await rows(page, 1);
  assert.match((await page.locator(".readout .value").textContent())!, /^4\.500 m/);
  await page.keyboard.press("Alt+ArrowRight");
  await page.keyboard.press("Escape");
  await page.keyboard.press("n");
  await page.waitForFunction(() => document.querySelector(".readout .place")?.textContent === "u 144  v 103", null, { timeout: 5000 }).catch(async () => assert.fail(`at ${await focus()}`));
  await page.keyboard.press("Delete");
  await rows(page, 0);
  await page.keyboard.press("?");
  await page.waitForSelector("dialog.help[open]");
  await page.keyboard.press("Escape");
  await page.waitForSelector("dialog.help", { state: "hidden" });
});
