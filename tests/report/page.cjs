// Opens a report in Chromium as its readers do, and ends with 1 if anything is wrong.
//
//     node page.cjs PAGE.html FOLDER    writes screenshots and a PDF into FOLDER
//
// NODE_PATH names a folder with playwright-core and axe-core; .ci/long has one.
"use strict";
const { readFileSync, writeFileSync } = require("node:fs");
const { join, resolve } = require("node:path");
const { pathToFileURL } = require("node:url");
const { chromium } = require("playwright-core");

const [file, folder] = process.argv.slice(2);
const page_url = pathToFileURL(resolve(file)).href;
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const SIZES = [[1280, 900], [390, 844]];
const problems = [];
const wrong = (what) => { problems.push(what); console.log(`wrong: ${what}`); };
const expect = (is, what) => is || wrong(what);

/** Texts that are wider than their box, and whatever makes the page scroll sideways. */
const cut = () => {
  const found = [];
  if (document.documentElement.scrollWidth > innerWidth) found.push(`the page is ${document.documentElement.scrollWidth} wide`);
  for (const each of document.querySelectorAll("body *")) {
    const style = getComputedStyle(each);
    const box = each.getBoundingClientRect();
    if (!box.width || each.closest(".scroll, .skip, svg, thead, .ends") || style.position === "absolute") continue;
    const text = [...each.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!text) continue;
    if (each.scrollWidth > each.clientWidth + 1 && style.overflowX !== "visible") found.push(`${each.tagName} ${each.textContent.slice(0, 40)}`);
    if (box.right > innerWidth + 1 || box.left < -1) found.push(`outside: ${each.tagName} ${each.textContent.slice(0, 40)}`);
  }
  return found;
};

const opened = async (browser, width, height, scheme) => {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme });
  context.setDefaultTimeout(300_000); // a busy machine
  const page = await context.newPage();
  const requests = [];
  page.on("request", (request) => requests.push(request.url()));
  page.on("console", (message) => wrong(`the console has ${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => wrong(`an error: ${error.message}`));
  const start = Date.now();
  await page.goto(page_url);
  console.log(`${width} px, ${scheme}: loaded in ${Date.now() - start} ms`);
  return { context, page, requests };
};

const violations = async (page, what) => {
  await page.evaluate(axe); // through the debugger, which no policy of the page stops
  const { violations: found } = await page.evaluate(() => axe.run(document, { resultTypes: ["violations"] }));
  for (const each of found) wrong(`axe, ${what}: ${each.id}, ${each.help}: ${each.nodes.slice(0, 3).map((node) => node.html.slice(0, 150)).join(" | ")}`);
  console.log(`axe, ${what}: ${found.length} violations`);
};

const used = async (page) => {
  await page.keyboard.press("Tab");
  expect(await page.evaluate(() => document.activeElement.className === "skip"), "the first Tab does not reach the link to the content");
  const all = await page.locator("[data-row]").count();
  await page.locator("#filter").fill("no such text anywhere");
  expect(await page.locator("[data-row]:not([hidden])").count() === 0, "a text that is nowhere is found");
  expect((await page.locator("#found").textContent()).startsWith(`0 of ${all}`), "the count of rows is not told");
  for (const box of await page.locator(".flow[data-words]").all()) {
    for (const word of (await box.getAttribute("data-words")).split(" ")) {
      await page.locator("#filter").fill(word.split("/").at(-1));
      expect(!(await box.evaluate((each) => each.hidden)), `Find does not find ${word}, which is folded`);
    }
  }
  await page.locator("#filter").fill("");
  expect(await page.locator("[data-row]:not([hidden])").count() === all, "rows stay hidden without a filter");
  await page.locator("#unfold").click();
  expect(await page.locator("details:not([open])").count() === 0, "not all is unfolded");
  await page.locator("#fold").click();
  expect(await page.locator("details[open]").count() === 0, "not all is folded");
  await pictured(page);
};

/** Which boxes of topics are shown, and to which lines go. */
const flows = () => {
  const boxes = [...document.querySelectorAll(".flow")];
  const shown = boxes.flatMap((each, number) => each.hidden ? [] : [number]);
  const drawn = [...new Set([...document.querySelectorAll("#lines path[data-flow]")].map((each) => +each.dataset.flow))];
  return { shown, drawn: drawn.sort((one, other) => one - other), texts: boxes.map((each) => each.querySelector(".topic bdi").textContent) };
};

/** Each topic, one of a robot's own by its real name: its box alone is shown, with its lines. */
const sought = async (page) => {
  const { shown: all, texts } = await page.evaluate(flows);
  const { label, group, member } = await page.locator(".picture .members").first().evaluate((list) => (
    { label: list.dataset.label, group: list.closest(".box").dataset.number, member: list.querySelector("li").textContent }));
  const [before, after] = label.split("{name}");
  const unit = member.slice(before.length, member.length - (after ?? "").length);
  for (const text of new Set(texts)) {
    const number = texts.indexOf(text);
    const own = (await page.locator(".flow").nth(number).getAttribute("data-own")).split(" ").includes(group);
    const typed = own ? text.replaceAll("{name}", unit) : text;
    await page.locator("#filter").fill(typed);
    const { shown, drawn } = await page.evaluate(flows);
    expect(shown.includes(number), `Find does not find ${typed}`);
    expect(shown.length < all.length, `Find leaves all boxes for ${typed}`);
    expect(`${drawn}` === `${shown}`, `after Find of ${typed} lines go to ${drawn}, not to ${shown}`);
  }
  await page.locator("#filter").fill("");
  expect((await page.evaluate(flows)).shown.length === all.length, "boxes stay hidden without a filter");
};

const pictured = async (page) => {
  if (await page.locator("#incomplete").count()) return; // rights may be missing
  const groups = page.locator("#senders details summary, #receivers details summary");
  expect(await page.locator("#lines path[data-flow]").count() > 0, "the picture has no lines");
  if (!(await groups.count())) return wrong("the picture has no group: this report does not show enough");
  await sought(page);
  await groups.first().focus();
  await page.keyboard.press("Enter");
  const members = page.locator(".picture details[open] .members button");
  expect(await members.count() > 1, "a group does not unfold by keyboard");
  await members.first().focus();
  await page.keyboard.press("Enter");
  const name = await members.first().textContent();
  expect((await page.locator("#chosen").textContent()).startsWith(`${name}: `), "a chosen participant is not told");
  await violations(page, "with a chosen participant");
  await page.keyboard.press("Enter");
  expect(await page.locator("#chosen").textContent() === "", "a participant cannot be left");
  await page.locator("#fold").click();
};

(async () => {
  const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
  for (const [width, height] of SIZES) {
    for (const scheme of ["light", "dark"]) {
      const { context, page, requests } = await opened(browser, width, height, scheme);
      const where = `${width} px, ${scheme}`;
      await violations(page, where);
      for (const each of await page.evaluate(cut)) wrong(`cut, ${where}: ${each}`);
      await page.screenshot({ path: join(folder, `${width}-${scheme}.png`) });
      if (width === SIZES[0][0] && scheme === "light") await used(page);
      await page.locator("#unfold").click();
      for (const each of await page.evaluate(cut)) wrong(`cut when unfolded, ${where}: ${each}`);
      if (!(await page.evaluate(() => document.body.scrollHeight > 60_000))) {
        await violations(page, `${where}, unfolded`);
        await page.screenshot({ path: join(folder, `${width}-${scheme}-unfolded.png`), fullPage: true });
      }
      expect(requests.length === 1 && requests[0] === page_url, `requests: ${requests}`);
      await context.close();
    }
  }
  const { page } = await opened(browser, 1280, 900, "light");
  for (const format of ["A4", "A3"]) {
    const pdf = await page.pdf({ format, path: join(folder, `${format}.pdf`) });
    expect(pdf.subarray(0, 5).toString() === "%PDF-" && pdf.length > 20_000, `no ${format} was printed`);
  }
  const paint = await page.evaluate(() => performance.getEntriesByName("first-contentful-paint")[0]?.startTime);
  console.log(`first paint after ${Math.round(paint)} ms`);
  await browser.close();
  writeFileSync(join(folder, "problems.txt"), problems.map((each) => `${each}\n`).join(""));
  console.log(problems.length ? `${problems.length} problems` : "no problems");
  process.exitCode = problems.length ? 1 : 0;
})();
