// The page: receives snapshots as server-sent events, and requests explanations and queries on demand.
// Texts of the program are inserted as textContent only, never as HTML: events may contain text from outside.

import { draw } from "./graph.js";

const RETRY = 4000;

const find = (id) => document.getElementById(id);
let source = null;
let graph = null;
let width = 0;
let setRates = () => {};
let last = null;
const opened = new Set();
let ended = 0;

// ---- Texts ---------------------------------------------------------------------------------------------------

function number(value) {
  return value === null || value === undefined ? "–" : value.toLocaleString("en");
}

function rate(value) {
  if (value === undefined || value === null) return "–";
  if (value < 0.05) return value > 0 ? "<0.1" : "0";
  return value >= 100 ? Math.round(value).toLocaleString("en") : value >= 10 ? value.toFixed(0) : value.toFixed(1);
}

function seconds(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value), sign = value < 0 ? "−" : "";
  if (size < 0.0005) return "0 s";
  if (size < 1) return `${sign}${(size * 1000).toFixed(0)} ms`;
  if (size < 10) return `${sign}${size.toFixed(2)} s`;
  if (size < 120) return `${sign}${size.toFixed(0)} s`;
  if (size < 7200) return `${sign}${(size / 60).toFixed(0)} min`;
  if (size < 172800) return `${sign}${(size / 3600).toFixed(0)} h`;
  return `${sign}${(size / 86400).toFixed(0)} d`;
}

const since = (now, instant) => instant === null ? "–" : seconds(now - instant);
const fileOf = (place) => place.split("/").pop().replace(/:\d+$/, "");
const titleOf = (rule) => `${rule.name} (${fileOf(rule.place) || "added at run time"})`;
const brief = (text) => text.replace(/(\d\.\d{3})\d+(?![\de])/g, "$1");

// ---- Elements ------------------------------------------------------------------------------------------------

function element(name, text = "", kind = "") {
  const made = document.createElement(name);
  if (text !== "") made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// Fill a table with rows, each { key, cells: [{ text, sub, kind, part }] }; unchanged elements are reused.
function fill(id, rows, columns, none) {
  const body = find(id).tBodies[0];
  const there = new Map(Array.from(body.rows, (row) => [row.dataset.key, row]));
  const wanted = rows.length ? rows : [{ key: "", cells: [{ text: none, kind: "none", columns }] }];
  wanted.forEach((row, at) => {
    const shown = there.get(row.key) || newRow(row);
    there.delete(row.key);
    if (body.rows[at] !== shown) body.insertBefore(shown, body.rows[at] || null);
    row.cells.forEach((cell, column) => fillCell(shown.cells[column], cell));
  });
  for (const gone of there.values()) gone.remove();
}

function newRow({ key, cells }) {
  const row = element("tr");
  row.dataset.key = key;
  for (const cell of cells) {
    const made = element("td");
    if (cell.columns) made.colSpan = cell.columns;
    made.append(element("span"));
    if (cell.sub !== undefined) made.append(element("span", "", "sub code"));
    if (cell.part !== undefined) {
      const bar = element("span", "", "bar");
      bar.append(element("i"));
      made.append(bar);
    }
    if (cell.press) made.addEventListener("click", cell.press);
    if (cell.button) {
      const button = element("button", cell.button);
      button.type = "button";
      button.addEventListener("click", cell.click);
      made.append(button);
    }
    row.append(made);
  }
  return row;
}

function fillCell(place, cell) {
  if (place.className !== (cell.kind || "")) place.className = cell.kind || "";
  set(place.firstChild, cell.text || "");
  if (cell.sub !== undefined) set(place.children[1], cell.sub);
  if (cell.part !== undefined) place.querySelector("i").style.width = `${Math.round(100 * cell.part)}%`;
}

const numeric = (text, bad = false, wide = false) => ({ text, kind: `n${bad ? " bad" : ""}${wide ? " wide" : ""}` });

// ---- Snapshots -----------------------------------------------------------------------------------------------

function showTiles({ status, rates, memory }) {
  const tiles = [
    ["events in /s", rate(rates.get("taken"))],
    ["rules fired /s", rate(rates.get("fired"))],
    ["in the queue", number(status.queued), status.queued > status.queue / 2 ? "bad" : ""],
    ["dropped", number(status.dropped), status.dropped ? "bad" : ""],
    ["errors", number(status.errors), status.errors ? "bad" : ""],
    ["warnings", number(status.warnings), status.warnings ? "warn" : ""],
    ["partial matches", number(status.matches)],
    ["waiting queries", number(status.waiting.length + status.left_out.waiting)],
    ["MB of memory", number(Math.round(memory / 1e6))],
  ];
  const place = find("tiles");
  while (place.children.length < tiles.length) {
    const tile = element("div", "", "tile");
    tile.append(element("b"), element("span"));
    place.append(tile);
  }
  tiles.forEach(([name, value, kind], at) => {
    const tile = place.children[at];
    tile.className = `tile ${kind || ""}`;
    set(tile.children[0], value);
    set(tile.children[1], name);
  });
}

function showWork({ status }) {
  const { work } = status, place = find("busy");
  const long = work !== null && work.seconds >= 1;
  place.hidden = !long;
  if (!long) return;
  const doing = [work.goal, work.event && `for event ${work.event}`, work.place && `at ${work.place}`]
    .filter(Boolean).join(", ");
  set(place, `Busy for ${seconds(work.seconds)} with ${work.what}${doing ? `: ${doing}` : ""}`);
}

function showForwarding({ forwarding }) {
  const place = find("forwarding");
  place.hidden = !forwarding;
  set(place, `Forwarding: ${forwarding}`);
}

function more(rows, left, columns) {
  if (left) rows.push({ key: "more", cells: [{ text: `and ${left} more`, kind: "none", columns }] });
  return rows;
}

function showTopics({ topics, rates }) {
  fill("topics", topics.map((one) => ({ key: one.name, cells: [
    { text: one.name, sub: one.kind + (one.publishers === 0 ? ", no publisher" : "") },
    numeric(rate(rates.get(`topic:${one.name}`))),
    numeric(seconds(one.age)),
    numeric(seconds(one.lag), one.lag > 1),
    numeric(number(one.dropped), one.dropped > 0),
  ] })), 5, "none are subscribed");
}

function showSubscriptions({ status }) {
  const rows = status.subscriptions.map((one) => ({ key: `${one.topic} ${one.id}`, cells: [
    { text: one.topic, kind: "name" }, { text: one.id, kind: "name" }, { text: one.event, kind: "wide code" }, numeric(number(one.sent)),
  ] }));
  fill("subscriptions", more(rows, status.left_out.subscriptions, 4), 4, "nothing is published");
}

function showMemories({ status, rates }) {
  const rows = status.memories.map((one) => ({ key: one.id, cells: [
    { text: one.id, sub: one.event },
    { ...numeric(`${number(one.records)} / ${number(one.size)}`), part: one.size ? one.records / one.size : 0 },
    numeric(one.oldest === null ? "–" : seconds(one.newest - one.oldest)),
    numeric(one.newest === null ? "–" : `${since(status.now, one.newest)} ago`),
    numeric(rate(rates.get(`memory:${one.id}`))),
  ] }));
  fill("memories", more(rows, status.left_out.memories, 5), 5, "there are none");
}

function showWaiting({ status }) {
  const place = find("waiting");
  const all = status.waiting.length + status.left_out.waiting;
  set(find("waiting-note"), all > 10 ? `the first 10 of ${all}` : "");
  const cards = status.waiting.slice(0, 10).map((one) => {
    const card = element("div", "", "card");
    card.append(element("span", one.event, "code"));
    card.append(element("span", `asked ${since(status.now, one.since)} ago; waits for`, "sub"));
    const list = element("ul");
    for (const memory of one.memories) {
      const behind = memory.behind === null ? "empty so far" : `${seconds(memory.behind)} behind`;
      list.append(element("li", `${memory.id}: ${behind}`));
    }
    if (one.left_out) list.append(element("li", `and ${one.left_out} more`));
    card.append(list);
    return card;
  });
  place.replaceChildren(...(cards.length ? cards : [element("p", "none waits", "none")]));
}

function showRules({ status, rates }) {
  const rows = status.rules.map((one, at) => ({ key: `${at} ${one.place}`, cells: [
    { text: titleOf(one), sub: one.text },
    numeric(number(one.fired)),
    numeric(rate(rates.get(`rule:${at}`))),
    numeric(one.last_fired === null ? "–" : `${since(status.now, one.last_fired)} ago`, false, true),
    numeric(number(one.waiting) + (one.dropped ? ` (${number(one.dropped)} lost)` : ""), one.dropped > 0, true),
    numeric(number(one.keys), false, true),
    numeric((one.bytes / 1e6).toFixed(1), false, true),
    numeric(number(one.errors), one.errors > 0),
  ] }));
  fill("rules", more(rows, status.left_out.rules, 8), 8, "there are none");
}

function showEvents({ events, status, explains }) {
  const part = find("filter").value;
  const rows = events.filter((one) => one.text.includes(part)).map((one) => {
    const asks = explains && one.whole;
    return { key: `${one.serial}`, cells: [
      numeric(since(status.now, one.end)),
      { text: opened.has(one.serial) ? one.text : brief(one.text), press: () => openOrClose(one.serial),
        kind: `code clamp${opened.has(one.serial) ? " whole" : ""}` },
      { text: "", kind: "n", button: asks ? "why?" : "", click: () => why(one) },
    ] };
  });
  fill("events", rows, 3, find("follow").checked ? "none yet" : "not followed");
}

function openOrClose(serial) {
  if (!opened.delete(serial)) opened.add(serial);
  if (opened.size > 100) opened.clear();
  showEvents(last);
}

function showGraph(rates) {
  const note = graph.left_out ? `${graph.left_out} parts are left out; ` : "";
  set(find("graph-note"), `${note}numbers are a second`);
  setRates(rates);
}

function redraw() {
  if (!graph) return;
  width = find("graph").clientWidth;
  setRates = draw(graph, find("graph"), rate);
  if (last) setRates(last.rates);
  find("legend").replaceChildren(...graph.legend.map(([kind, text]) => {
    const entry = element("span");
    entry.append(element("i", "", `k-${kind}`), text);
    return entry;
  }));
  showScrollHint();
}

// Shade the sides to which the graph continues, and say so: scroll bars are hidden on many systems.
function showScrollHint() {
  const { scrollLeft, clientWidth, scrollWidth, classList } = find("graph");
  const before = scrollLeft > 1, after = scrollLeft + clientWidth < scrollWidth - 1;
  classList.toggle("before", before);
  classList.toggle("after", after);
  find("graph-scroll").hidden = !(before || after);
}

function show(snapshot) {
  last = snapshot;
  document.title = `${snapshot.title} – retalis`;
  set(find("title"), snapshot.title);
  find("asking").hidden = !snapshot.queries;
  for (const part of [showTiles, showWork, showForwarding, showTopics, showSubscriptions, showMemories,
    showWaiting, showRules, showEvents]) part(snapshot);
  if (graph) showGraph(snapshot.rates);
  document.body.dataset.looks = Number(document.body.dataset.looks || 0) + 1;
}

// ---- Requests ------------------------------------------------------------------------------------------------

async function ask(path, asked) {
  try {
    const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" },
      body: JSON.stringify(asked) });
    return answer.ok ? await answer.json() : { error: await answer.text() };
  } catch (error) {
    return { error: "the node does not answer" };
  }
}

async function why(event) {
  find("why").hidden = false;
  set(find("why-title"), brief(event.text));
  set(find("why-text"), "...");
  const found = await ask("explain", { serial: event.serial });
  set(find("why-text"), "error" in found ? found.error : found.lines.join("\n"));
}

function solutionText(solution) {
  return solution.length ? solution.map(([name, value]) => `${name} = ${value}`).join("\n") : "true";
}

async function query(event) {
  event.preventDefault();
  const answer = find("answer");
  answer.hidden = false;
  set(answer, "...");
  const found = await ask("query", { goal: find("goal").value });
  if ("error" in found) return set(answer, found.error);
  const texts = found.solutions.map(solutionText);
  if (!texts.length) texts.push("false");
  else if (!found.complete) texts.push("... there may be more");
  return set(answer, texts.join("\n\n"));
}

// ---- The stream ----------------------------------------------------------------------------------------------

function state(text, kind) {
  set(find("state"), text);
  find("state").className = kind;
}

function close() {
  clearTimeout(ended);
  if (source) source.close();
  source = null;
}

function open() {
  close();
  source = new EventSource(`stream?events=${find("follow").checked ? 1 : 0}`);
  source.addEventListener("graph", (event) => { graph = JSON.parse(event.data); redraw(); });
  source.addEventListener("snapshot", (event) => {
    const snapshot = JSON.parse(event.data);
    state("live", "live");
    // The only part with keys from the program: a counter without a former value has no rate.
    show({ ...snapshot, rates: new Map(Object.entries(snapshot.rates)) });
  });
  source.onerror = () => {
    const refused = source.readyState === EventSource.CLOSED;
    state(refused ? "refused: too many pages are open" : "the node does not answer", "lost");
    if (refused) ended = setTimeout(open, RETRY);
  };
}

find("graph").addEventListener("scroll", showScrollHint);
find("query").addEventListener("submit", query);
find("why-close").addEventListener("click", () => { find("why").hidden = true; });
find("follow").addEventListener("change", open);
find("filter").addEventListener("input", () => { if (last) showEvents(last); });
new ResizeObserver(() => requestAnimationFrame(() => {
  if (find("graph").clientWidth !== width) redraw();
})).observe(find("graph"));
document.addEventListener("visibilitychange", () => {
  if (document.hidden) { close(); state("paused", ""); } else open();
});
open();
