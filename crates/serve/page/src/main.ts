// The page of `lsdc view` and `lsdc serve`, and of a folder of static files, which completes images in the browser.

import { open } from "./page.ts";
import { server } from "./server.ts";

/** Whether the files are those of a folder (build.mjs): the page of the program is always served by it. */
declare const STATIC: boolean;

/** Whether a program answers at this address. A folder has the same address as a file, or none. */
async function isServed(): Promise<boolean> {
  const reply = await fetch("v1/start").catch(() => null);
  if (!reply || reply.status === 404) return false;
  const { browser } = await reply.json().catch(() => ({ browser: reply.ok }));
  return browser !== true;
}

open(STATIC && !(await isServed()) ? (await import("./browser/service.ts")).browser : server);
