// Assembles the page from its views.

import "./style/page.css";
import { App } from "./app.ts";
import { h, iconButton, segments, slider } from "./dom.ts";
import * as link from "./model/link.ts";
import { LAYERS, THEMES } from "./model/settings.ts";
import type { Service } from "./service.ts";
import { Busy } from "./views/busy.ts";
import { Cloud } from "./views/cloud.ts";
import { Downloads } from "./views/downloads.ts";
import { Gallery } from "./views/gallery.ts";
import { Help } from "./views/help.ts";
import { Legend } from "./views/legend.ts";
import { List } from "./views/list.ts";
import { Notices } from "./views/notice.ts";
import { Numbers } from "./views/numbers.ts";
import { chooseImage, Panel } from "./views/panel.ts";
import { Profile } from "./views/profile.ts";
import { Readout } from "./views/readout.ts";
import { Stage } from "./views/stage.ts";
import { StartPage } from "./views/start.ts";

/** Builds the page in the document. */
export function open(service: Service): void {
  const app = new App(service);
  const stage = new Stage(app, () => profile.redraw());
  const profile = new Profile(app, stage.frame);
  const legend = new Legend();
  const readout = new Readout();
  const cloud = new Cloud(app);
  const numbers = new Numbers();
  const panel = new Panel(app);
  const list = new List(app);
  const downloads = new Downloads(app);
  const notices = new Notices(app);
  const startPage = new StartPage(app);
  const help = new Help();
  const busy = new Busy();

  const layer = segments("Map", [["depth", "Depth"], ["deviation", "Deviation"], ["none", "None"]], (layer: (typeof LAYERS)[number]) => app.look({ layer }));
  const opacity = slider({
    label: "Opacity of the map", hidden: true, steps: 100, text: (step) => `${step} %`, change: (step) => app.look({ opacity: step / 100 }),
  });
  const undo = iconButton("undo", "Undo", app.undo);
  const redo = iconButton("redo", "Redo", app.redo);
  const name = h("h1", { class: "scene" });
  const theme = iconButton("theme", "Light or dark", () => {
    const dark = getComputedStyle(document.documentElement).colorScheme === "dark"
      || (app.store.state.view.theme === "auto" && matchMedia("(prefers-color-scheme: dark)").matches);
    app.look({ theme: dark ? "light" : "dark" });
  });
  const open = chooseImage(app, "Open…");
  const back = h("button", { type: "button", class: "quiet", hidden: true, onclick: () => showGallery() }, "Gallery");

  stage.element.append(busy.element);
  const main = h("main", {},
    startPage.element,
    h("div", { class: "work" },
      h("section", { class: "pane image", "aria-label": "Image" },
        h("header", {}, h("h2", {}, "Map"), layer.element, opacity.element),
        stage.element,
        h("footer", {}, readout.element, legend.element)),
      cloud.element, profile.element, list.element,
      h("aside", { "aria-label": "Settings" }, numbers.element, panel.element)));

  document.body.append(
    h("header", { class: "top" },
      h("a", { class: "mark", href: "#", "aria-label": "lsdc, to the start", onclick: toStart }, "lsdc"),
      name, back,
      h("nav", { "aria-label": "Actions" }, open, undo, redo, downloads.element, theme, iconButton("keys", "Keys", help.open))),
    main, notices.element, help.element);

  let gallery: Gallery | null = null;

  app.store.watch((state) => {
    const { scene, view, canUndo, canRedo } = state;
    document.body.dataset.fitting = String(state.fitting);
    document.body.dataset.showing = scene ? "work" : gallery ? "gallery" : "start";
    document.documentElement.dataset.theme = view.theme;
    name.textContent = scene ? `${scene.name}  ${scene.width}×${scene.height}` : "";
    name.title = name.textContent;
    name.hidden = !scene;
    document.title = scene ? `${scene.name} – lsdc` : "lsdc";
    undo.disabled = !canUndo;
    redo.disabled = !canRedo;
    undo.hidden = redo.hidden = !scene;
    open.hidden = !scene;
    back.hidden = !gallery || !scene;
    layer.set(view.layer);
    opacity.set(Math.round(100 * view.opacity));
    for (const part of [busy, stage, profile, legend, readout, cloud, numbers, panel, list, downloads, notices]) part.show(state);
  });

  function toStart(event: Event): void {
    event.preventDefault();
    app.close();
  }

  function showGallery(): void {
    app.close();
  }

  // Files can be dropped anywhere on the page.
  for (const kind of ["dragover", "dragenter"] as const) {
    document.addEventListener(kind, (event) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      document.body.classList.add("dropping");
    });
  }
  document.addEventListener("dragleave", (event) => !event.relatedTarget && document.body.classList.remove("dropping"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    const files = [...(event.dataTransfer?.files ?? [])];
    if (files.length > 0) void app.openFiles(files);
  });

  document.addEventListener("keydown", (event) => {
    const typing = event.target instanceof HTMLInputElement && event.target.type !== "range" && event.target.type !== "radio";
    if (typing) return;
    const control = event.ctrlKey || event.metaKey;
    if (control && event.key.toLowerCase() === "z") (event.shiftKey ? app.redo : app.undo)();
    else if (control && event.key.toLowerCase() === "y") app.redo();
    else if (event.key === "?" && !control) help.open();
    else return;
    event.preventDefault();
  });

  const redraw = (): void => {
    for (const part of [stage, profile, cloud]) part.redraw();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let lastTheme: (typeof THEMES)[number] = "auto";
  app.store.watch(({ view }) => {
    if (view.theme === lastTheme) return;
    lastTheme = view.theme;
    redraw();
  });

  async function begin(): Promise<void> {
    const linked = link.read(location.hash);
    const [started, demos] = await Promise.all([service.start(), service.demos().catch(() => [])]);
    startPage.list(demos);
    if (started.gallery) {
      const { runs } = await service.gallery();
      gallery = new Gallery(app, runs, () => undefined);
      main.append(gallery.element);
      app.look({});
    }
    const { source } = linked;
    const opened = () => app.openAddresses(started.image!, started.points ?? null, started.camera ?? null, started.name);
    // The address does not contain the user's image; after a reload, do not open another one unasked.
    const other = Boolean(source && "file" in source && source.file !== started.name);
    const instead = other && started.image ? { label: `Open ${started.name ?? "the first image"}`, run: () => (app.dismiss(), void opened()) } : null;
    if (location.hash.length > 1) app.expect(linked, instead);
    if (source && "demo" in source) {
      const demo = demos.find((one) => one.name === source.demo);
      if (demo) return app.openDemo(demo);
      app.note(`there is no demo called ${source.demo}`, "the link may be from another version of lsdc");
    }
    if (started.image && !other) await opened();
  }

  void begin().catch((error: unknown) => app.fail(error));
}
