// Creates elements of the page.

type Props = Record<string, unknown>;
type Child = Node | string | null | undefined | false;

/** Creates an element. `onclick` and the like are listeners; `class`, and names that are no property, are attributes. */
export function h<Tag extends keyof HTMLElementTagNameMap>(tag: Tag, props: Props = {}, ...children: Child[]): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value as EventListener);
    else if (key in element && !key.includes("-") && key !== "list") (element as unknown as Props)[key] = value;
    else element.setAttribute(key, String(value === true ? "" : value));
  }
  element.append(...children.filter((child): child is Node | string => child instanceof Node || typeof child === "string"));
  return element;
}

const SHAPES = {
  undo: "M8 5 4 9l4 4M4 9h9a5 5 0 0 1 0 10h-3",
  redo: "m12 5 4 4-4 4m4-4H7a5 5 0 0 0 0 10h3",
  link: "M8.5 11.5a3 3 0 0 0 4.2 0l2.8-2.8a3 3 0 0 0-4.2-4.2l-.8.8m1 3.2a3 3 0 0 0-4.2 0l-2.8 2.8a3 3 0 0 0 4.2 4.2l.8-.8",
  theme: "M10 3a7 7 0 1 0 0 14Zm0 0a7 7 0 0 1 0 14",
  keys: "M3 5.5h14v9H3zM6 8.5h.01M9 8.5h.01M12 8.5h.01M14.5 8.5h.01M6.5 11.5h7",
  open: "M3 15.5v-11h5l1.5 2H17v9z",
  home: "M4 9.5 10 4l6 5.5M5.5 8.5v7h9v-7",
  close: "m5.5 5.5 9 9m0-9-9 9",
  bin: "M4.5 6h11M8 6V4h4v2m-6 0 .7 10h6.6L14 6",
  previous: "m12 5-5 5 5 5",
  next: "m8 5 5 5-5 5",
} as const;

export function icon(name: keyof typeof SHAPES): SVGSVGElement {
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  svg.setAttribute("viewBox", "0 0 20 20");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(space, "path");
  path.setAttribute("d", SHAPES[name]);
  svg.append(path);
  return svg;
}

export function iconButton(name: keyof typeof SHAPES, label: string, onclick: () => void, props: Props = {}): HTMLButtonElement {
  return h("button", { type: "button", class: "icon", "aria-label": label, title: label, onclick, ...props }, icon(name));
}

let names = 0;
/** A unique name of an element, for labels that refer to it. */
export const unique = (stem: string): string => `${stem}-${++names}`;

export interface Control<T> {
  readonly element: HTMLElement;
  set(value: T): void;
}

/** Radio buttons drawn as one segmented switch. */
export function segments<T extends string>(label: string, choices: readonly (readonly [T, string])[], choose: (value: T) => void): Control<T> {
  const name = unique("segments");
  const inputs = new Map<T, HTMLInputElement>();
  const element = h("fieldset", { class: "segments" }, h("legend", { class: "hidden" }, label));
  for (const [value, text] of choices) {
    const input = h("input", { type: "radio", name, value, onchange: () => choose(value) });
    inputs.set(value, input);
    element.append(h("label", {}, input, h("span", {}, text)));
  }
  return { element, set: (value) => void (inputs.get(value)!.checked = true) };
}

export function select<T extends string>(label: string, choices: readonly (readonly [T, string])[], choose: (value: T) => void): Control<T> {
  const input = h("select", { onchange: () => choose(input.value as T) });
  for (const [value, text] of choices) input.append(h("option", { value }, text));
  return { element: h("label", { class: "field" }, h("span", {}, label), input), set: (value) => void (input.value = value) };
}

export function check(label: string, title: string, change: (on: boolean) => void): Control<boolean> & { note(text: string): void } {
  const input = h("input", { type: "checkbox", onchange: () => change(input.checked) });
  const note = h("span", { class: "amount" });
  return {
    element: h("label", { class: "check", title }, input, h("span", {}, label), note),
    set: (on) => void (input.checked = on),
    note: (text) => void (note.textContent = text),
  };
}

interface Slide {
  readonly label: string;
  readonly hidden?: boolean;
  readonly steps: number;
  /** Value of a step as text, shown beside the slider and read by screen readers. */
  readonly text: (step: number) => string;
  readonly change: (step: number) => void;
  readonly done?: () => void;
}

/** A slider over the integers from 0 to `steps`. */
export function slider({ label, hidden, steps, text, change, done }: Slide): Control<number> & { limit(steps: number): void } {
  const input = h("input", { type: "range", min: "0", max: String(steps), step: "1", "aria-label": label });
  const output = h("span", { class: "amount", "aria-hidden": "true" });
  const show = () => {
    const words = text(Number(input.value));
    output.textContent = words;
    input.setAttribute("aria-valuetext", words);
    input.style.setProperty("--share", String(Number(input.value) / Math.max(1, Number(input.max))));
  };
  input.addEventListener("input", () => {
    show();
    change(Number(input.value));
  });
  input.addEventListener("change", () => done?.());
  const element = h("label", { class: hidden ? "slider bare" : "slider" }, hidden ? null : h("span", { class: "name" }, label), output, input);
  return {
    element,
    set: (step) => {
      input.value = String(step);
      show();
    },
    limit: (most) => void (input.max = String(most)),
  };
}

/** Starts the download of a file. */
export function save(name: string, contents: Blob): void {
  const href = URL.createObjectURL(contents);
  h("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 60_000);
}

/** Resizes a canvas to the resolution of the screen and returns device pixels per CSS pixel, at most 3. */
export function sized(canvas: HTMLCanvasElement, width: number, height: number): number {
  const density = Math.min(3, window.devicePixelRatio || 1);
  const [w, h] = [Math.max(1, Math.round(width * density)), Math.max(1, Math.round(height * density))];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  return density;
}

/** Colours of the page, for drawing on canvases. */
export function inks(element: Element): Record<"ink" | "quiet" | "line" | "paper" | "well" | "mark", string> {
  const style = getComputedStyle(element);
  const colour = (name: string) => style.getPropertyValue(`--${name}`).trim();
  return {
    ink: colour("ink"), quiet: colour("quiet"), line: colour("line"), paper: colour("paper"), well: colour("well"), mark: colour("mark"),
  };
}
