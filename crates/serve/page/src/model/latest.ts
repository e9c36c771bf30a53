// Runs one request at a time; of waiting requests, only the latest is kept.

export class Latest<Input, Output> {
  private running = false;
  private next: { input: Input } | null = null;

  constructor(
    private readonly run: (input: Input) => Promise<Output>,
    private readonly done: (output: Output, input: Input, waiting: boolean) => void,
    private readonly failed: (error: unknown, input: Input) => void,
  ) {}

  get busy(): boolean {
    return this.running;
  }

  request(input: Input): void {
    this.next = { input };
    if (!this.running) void this.work();
  }

  /** Drops the waiting request. */
  clear(): void {
    this.next = null;
  }

  private async work(): Promise<void> {
    this.running = true;
    for (let job = this.take(); job; job = this.take()) {
      try {
        const output = await this.run(job.input);
        this.done(output, job.input, this.next !== null);
      } catch (error) {
        this.failed(error, job.input);
      }
    }
    this.running = false;
  }

  private take(): { input: Input } | null {
    const job = this.next;
    this.next = null;
    return job;
  }
}
