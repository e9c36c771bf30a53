// The page as a folder of static files, which completes images in the browser.

import { browser } from "./browser/service.ts";
import { open } from "./page.ts";

open(browser);
