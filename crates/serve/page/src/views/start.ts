// The first page: open an image, or a demo.

import type { App } from "../app.ts";
import { h } from "../dom.ts";
import type { Demo } from "../service.ts";
import { chooseImage } from "./panel.ts";

export class StartPage {
  private readonly demos = h("div", { class: "demos" });
  readonly element: HTMLElement;

  constructor(private readonly app: App) {
    this.element = h("section", { class: "start", "aria-label": "Start" },
      h("div", { class: "drop" },
        h("h1", {}, "An image and a few known depths in, a dense depth map in metres out."),
        h("p", {}, "Drop an image here, alone or with its points. Then click into it where you know a depth: the map follows each point, and says how far it may be off."),
        h("div", { class: "buttons" }, chooseImage(app, "Open an image…", true)),
        h("p", { class: "why" }, `${app.service.reads} Nothing leaves this machine.`)),
      this.demos);
  }

  list(demos: readonly Demo[]): void {
    this.demos.classList.toggle("several", demos.length > 1);
    this.demos.replaceChildren(...demos.map((demo) =>
      h("button", { type: "button", class: "demo", onclick: () => void this.app.openDemo(demo) },
        h("img", { src: demo.image, alt: "", loading: "lazy" }),
        h("span", {}, h("strong", {}, demo.title ?? demo.name), h("span", {}, "Open the demo")))));
  }
}
