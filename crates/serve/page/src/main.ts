// Entry point: the page of `lsdc view` and `lsdc serve`, or static files that complete images in the browser.

import { open } from "./page.ts";
import { server } from "./server.ts";

/** Whether this is the build of static files (build.mjs). */
declare const STATIC: boolean;

/** Whether a program serves the page. Static hosting has a file at the same address, or none. */
async function isServed(): Promise<boolean> {
  const reply = await fetch("v1/start").catch(() => null);
  if (!reply || reply.status === 404) return false;
  const { browser } = await reply.json().catch(() => ({ browser: reply.ok }));
  return browser !== true;
}

open(STATIC && !(await isServed()) ? (await import("./browser/service.ts")).browser : server);
