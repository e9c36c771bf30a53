// Gestures of mouse, pen and fingers on the stage: click, drag of a point, pan, pinch.

export interface Gestures {
  /** Index of the point within `reach` of a position, or null. */
  hit(x: number, y: number, reach: number): number | null;
  press(): void;
  hover(x: number, y: number): void;
  leave(): void;
  click(x: number, y: number, hit: number | null): void;
  drag(hit: number, x: number, y: number): void;
  drop(): void;
  pan(dx: number, dy: number): void;
  zoom(factor: number, x: number, y: number): void;
  /** Whether dragging one finger moves the image instead of scrolling the page. */
  holds(): boolean;
}

interface Contact {
  x: number;
  y: number;
}

export class Pointers {
  private readonly contacts = new Map<number, Contact>();
  private start: (Contact & { hit: number | null; moved: boolean }) | null = null;

  constructor(
    private readonly area: HTMLElement,
    private readonly gestures: Gestures,
  ) {
    area.addEventListener("pointerdown", (event) => this.down(event));
    area.addEventListener("pointermove", (event) => this.move(event));
    area.addEventListener("pointerup", (event) => this.up(event));
    area.addEventListener("pointercancel", (event) => this.cancel(event));
    area.addEventListener("pointerleave", () => this.contacts.size === 0 && gestures.leave());
    area.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    area.addEventListener("touchstart", (event) => this.touch(event), { passive: false });
  }

  private place(event: { clientX: number; clientY: number }): Contact {
    const box = this.area.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  private reach = (event: PointerEvent): number => (event.pointerType === "mouse" ? 9 : 20);

  private down(event: PointerEvent): void {
    if (event.button !== 0) return;
    const at = this.place(event);
    this.contacts.set(event.pointerId, at);
    this.area.setPointerCapture(event.pointerId);
    this.gestures.press();
    this.start = this.contacts.size === 1 ? { ...at, hit: this.gestures.hit(at.x, at.y, this.reach(event)), moved: false } : null;
  }

  private move(event: PointerEvent): void {
    const at = this.place(event);
    const before = this.contacts.get(event.pointerId);
    if (!before) return this.gestures.hover(at.x, at.y);
    const other = [...this.contacts].find(([id]) => id !== event.pointerId)?.[1];
    this.contacts.set(event.pointerId, at);
    if (other) {
      const apart = (a: Contact) => Math.hypot(a.x - other.x, a.y - other.y) || 1;
      this.gestures.zoom(apart(at) / apart(before), (at.x + other.x) / 2, (at.y + other.y) / 2);
      this.gestures.pan((at.x - before.x) / 2, (at.y - before.y) / 2);
    } else if (this.start) {
      const slack = event.pointerType === "mouse" ? 3 : 8;
      this.start.moved ||= Math.hypot(at.x - this.start.x, at.y - this.start.y) > slack;
      if (!this.start.moved) return;
      if (this.start.hit !== null) this.gestures.drag(this.start.hit, at.x, at.y);
      else this.gestures.pan(at.x - before.x, at.y - before.y);
    }
  }

  private up(event: PointerEvent): void {
    const at = this.place(event);
    if (!this.contacts.delete(event.pointerId) || !this.start) return;
    const { hit, moved } = this.start;
    this.start = null;
    if (!moved) this.gestures.click(at.x, at.y, hit);
    else if (hit !== null) this.gestures.drop();
  }

  private cancel(event: PointerEvent): void {
    this.contacts.delete(event.pointerId);
    if (this.start?.moved && this.start.hit !== null) this.gestures.drop();
    this.start = null;
  }

  /** Zooms if the page cannot scroll or Ctrl is held (which a pinch on a touchpad sends). */
  private wheel(event: WheelEvent): void {
    const { scrollHeight, clientHeight } = document.documentElement;
    if (!event.ctrlKey && !event.metaKey && scrollHeight > clientHeight + 1) return;
    event.preventDefault();
    const at = this.place(event);
    this.gestures.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.002)), at.x, at.y);
  }

  /** Prevents the page from scrolling for two fingers, a finger on a point, or a finger on a magnified image. */
  private touch(event: TouchEvent): void {
    const first = event.touches[0];
    if (!first) return;
    const { x, y } = this.place(first);
    const ours = event.touches.length > 1 || this.gestures.holds() || this.gestures.hit(x, y, 20) !== null;
    if (ours && event.cancelable) event.preventDefault();
  }
}
