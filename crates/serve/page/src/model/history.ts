// Undo and redo of immutable states.

export class History<T> {
  private past: T[] = [];
  private future: T[] = [];
  private gesture: string | null = null;

  constructor(
    private now: T,
    private readonly most = 200,
  ) {}

  get current(): T {
    return this.now;
  }
  get canUndo(): boolean {
    return this.past.length > 0;
  }
  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** Adds a state. States of one gesture (a drag, a number being typed) are undone in one step. */
  push(state: T, gesture: string | null = null): void {
    if (state === this.now) return;
    if (gesture === null || gesture !== this.gesture) {
      this.past.push(this.now);
      if (this.past.length > this.most) this.past.shift();
    }
    this.future = [];
    this.gesture = gesture;
    this.now = state;
  }

  /** Ends a gesture: the next state is a separate step, even if its gesture has the same name. */
  seal(): void {
    this.gesture = null;
  }

  undo(): T {
    return this.step(this.past, this.future);
  }
  redo(): T {
    return this.step(this.future, this.past);
  }

  private step(from: T[], to: T[]): T {
    this.gesture = null;
    const state = from.pop();
    if (state !== undefined) {
      to.push(this.now);
      this.now = state;
    }
    return this.now;
  }
}
