import assert from "node:assert/strict";
import { test } from "node:test";
import { History } from "../../src/model/history.ts";
import { Latest } from "../../src/model/latest.ts";

test("states come back in order, and a new one ends what could be redone", () => {
  const history = new History("a");
  history.push("b");
  history.push("c");
  assert.deepEqual([history.undo(), history.undo(), history.undo()], ["b", "a", "a"]);
  assert.ok(!history.canUndo && history.canRedo);
  assert.equal(history.redo(), "b");
  history.push("d");
  assert.ok(!history.canRedo);
  assert.deepEqual([history.redo(), history.undo()], ["d", "b"]);
});

test("a gesture is one step until it is sealed", () => {
  const history = new History(0);
  for (const value of [1, 2, 3]) history.push(value, "drag");
  history.seal();
  for (const value of [4, 5]) history.push(value, "drag");
  history.push(6, "other");
  assert.deepEqual([history.undo(), history.undo(), history.undo()], [5, 3, 0]);
});

test("the same state is no step, and the oldest steps are forgotten", () => {
  const history = new History(0, 3);
  history.push(0);
  assert.ok(!history.canUndo);
  for (let value = 1; value <= 5; value++) history.push(value);
  for (let i = 0; i < 9; i++) history.undo();
  assert.equal(history.current, 2);
});

test("one request at a time, and of those that wait the latest", async () => {
  const open: { input: number; answer: (value: number) => void; refuse: (error: Error) => void }[] = [];
  const done: string[] = [];
  const latest = new Latest<number, number>(
    (input) => new Promise((answer, refuse) => open.push({ input, answer, refuse })),
    (output, input, waiting) => done.push(`${input}=${output}${waiting ? " and more" : ""}`),
    (error, input) => done.push(`${input}: ${(error as Error).message}`),
  );
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  for (const input of [1, 2, 3]) latest.request(input);
  assert.deepEqual(open.map(({ input }) => input), [1]);
  open[0]!.answer(10);
  await settle();
  assert.deepEqual(open.map(({ input }) => input), [1, 3]);
  latest.request(4);
  open[1]!.refuse(new Error("no"));
  await settle();
  latest.request(5);
  latest.clear();
  open[2]!.answer(40);
  await settle();
  assert.deepEqual(done, ["1=10 and more", "3: no", "4=40"]);
  assert.ok(!latest.busy);
});
