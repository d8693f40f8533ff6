// Starts the parts of the page.

import {attempt, listen} from "./api.js";
import * as camera from "./camera.js";
import * as editing from "./editing.js";
import * as hand from "./hand.js";
import * as heights from "./heights.js";
import * as jobs from "./jobs.js";
import * as jog from "./jog.js";
import * as machine from "./machine.js";
import * as making from "./making.js";
import * as measuring from "./measuring.js";
import * as parts from "./parts.js";
import * as picture from "./picture.js";
import * as probing from "./probing.js";
import * as records from "./records.js";
import * as texts from "./texts.js";

await texts.begin();
parts.begin(picture.redraw);
await attempt(async () => {
  await machine.begin();
  jog.begin();
  hand.begin();
  camera.begin();
  await probing.begin();
  await heights.begin();
  await making.begin();
  await measuring.begin();
  editing.begin();
  await jobs.begin();
  picture.begin();
  records.begin();
  machine.needs();
  listen();
});
