// The menu of downloads, the equivalent command, and the link.

import type { App } from "../app.ts";
import { h, iconButton, save } from "../dom.ts";
import { assumed } from "../model/camera.ts";
import { FORMATS, type Format, type Intrinsics } from "../service.ts";
import type { State } from "../state.ts";

/** The file of points and the command that compute the same map. */
export function command({ scene, draft, view }: State): { points: string; text: string } {
  if (!scene) return { points: "points.csv", text: "" };
  const changed = draft.points !== scene.given || draft.count !== null || draft.fit.sigma !== null || scene.pointsName === null;
  const points = changed ? `${scene.name.replace(/\.[^.]*$/, "")}_points.csv` : scene.pointsName!;
  const quoted = (name: string) => (/^[\w./-]+$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`);
  const { robust, fit, prior } = draft.fit;
  const cloud = view.cut !== null;
  const flags = [
    robust && `--robust ${robust}`, fit && `--fit ${fit}`, prior && `--prior ${prior}`,
    scene.cameraFile ? `--camera ${quoted(scene.cameraFile.name)}` : cloud && `--camera ${numbers(assumed(scene, view.field))}`,
    cloud && `--max-sigma ${Number(view.cut!.toPrecision(3))} --formats ply`,
    cloud && view.unmeasured && "--max-relative-sigma 1e6",
    cloud && view.flying && "--keep-flying",
  ].filter(Boolean);
  return { points, text: ["lsdc complete", quoted(scene.name), quoted(points), ...flags].join(" ") };
}

const numbers = ({ fx, fy, cx, cy }: Intrinsics): string => [fx, fy, cx, cy].map((value) => Number(value.toFixed(3))).join(",");

export class Downloads {
  readonly element: HTMLElement;
  private readonly details: HTMLDetailsElement;
  private readonly buttons: HTMLButtonElement[];
  private readonly line = h("code", {});
  private readonly assumed = h("p", { class: "why" });

  constructor(private readonly app: App) {
    this.buttons = app.service.formats.map((format) => {
      const { label, note } = FORMATS[format];
      return h("button", { type: "button", class: "row", onclick: () => void this.take(format) }, h("strong", {}, label), h("span", {}, note));
    });
    this.details = h("details", { class: "menu" },
      h("summary", { class: "button" }, "Download"),
      h("div", { class: "sheet", role: "group", "aria-label": "Download" },
        ...this.buttons, this.assumed,
        h("p", { class: "why" }, "The same on the command line, with the points saved as CSV:"),
        h("div", { class: "command" }, this.line, h("button", { type: "button", onclick: () => void this.copy(this.line.textContent ?? "", "the command is copied") }, "Copy"))),
    );
    this.element = h("div", { class: "take" },
      iconButton("link", "Copy a link with all settings", () => void this.copy(app.link(), "the link is copied", this.without())),
      this.details);
    document.addEventListener("pointerdown", (event) => {
      if (!this.details.contains(event.target as Node)) this.details.open = false;
    });
    this.details.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || !this.details.open) return;
      this.details.open = false;
      this.details.querySelector("summary")!.focus();
      event.stopPropagation();
    });
  }

  show(state: State): void {
    const { scene, draft, view } = state;
    this.element.hidden = !scene;
    for (const button of this.buttons) button.disabled = draft.points.length === 0;
    this.line.textContent = command(state).text;
    this.assumed.textContent = scene && !scene.camera ? `PLY assumes a field of view of ${Math.round(view.field)}°: no camera is known.` : "";
  }

  private async take(format: Format): Promise<void> {
    const file = await this.app.download(format);
    if (file) save(file.name, file.contents);
    this.details.open = false;
  }

  /** A hint at what the link contains. */
  private without(): string | null {
    const { scene } = this.app.store.state;
    return scene && "file" in scene.source ? `it holds settings and points; its reader opens ${scene.name} first` : "it holds the demo, settings and points";
  }

  private async copy(text: string, said: string, hint: string | null = null): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
      this.app.note(said, hint);
    } catch {
      this.app.note("the browser does not let the page copy", text);
    }
  }
}
