// The page of `lsdc view` and `lsdc serve`.

import { open } from "./page.ts";
import { server } from "./server.ts";

open(server);
