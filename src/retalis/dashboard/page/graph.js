// Layered drawing of a program's graph from left to right, as SVG (Sugiyama method).
//
// 1. Each node is assigned to the layer after its last predecessor; edges that close a cycle are reversed for this.
// 2. An edge over several layers gets a dummy position in each layer that it crosses, so that it passes between nodes.
// 3. Within a layer, nodes are ordered by the mean position of the nodes that they are connected with (barycenter).

const SPACE = "http://www.w3.org/2000/svg";
const WIDTH = 132, HEIGHT = 26, ACROSS = 184, DOWN = 34, NARROW = 14, MARGIN = 10, SWEEPS = 12, LONGEST = 17;

function layersOf(nodes, edges) {
  const out = new Map(nodes.map((node) => [node.id, []]));
  for (const edge of edges) out.get(edge.source).push(edge);
  const state = new Map();
  const turned = new Set();
  for (const root of nodes) {  // depth first, iterative: a program may have long chains
    if (state.has(root.id)) continue;
    const stack = [[root.id, 0]];
    state.set(root.id, 1);
    while (stack.length) {
      const top = stack[stack.length - 1];
      const edge = out.get(top[0])[top[1]++];
      if (!edge) { state.set(top[0], 2); stack.pop(); continue; }
      const seen = state.get(edge.target);
      if (seen === 1) turned.add(edge);
      else if (!seen) { state.set(edge.target, 1); stack.push([edge.target, 0]); }
    }
  }
  const layer = new Map(nodes.map((node) => [node.id, 0]));
  const ways = edges.filter((edge) => edge.source !== edge.target)
    .map((edge) => turned.has(edge) ? [edge.target, edge.source, edge] : [edge.source, edge.target, edge]);
  for (let round = 0, moved = true; moved && round < nodes.length; round++) {
    moved = false;
    for (const [from, to] of ways) {
      if (layer.get(to) <= layer.get(from)) { layer.set(to, layer.get(from) + 1); moved = true; }
    }
  }
  const entered = new Set(ways.map(([, to]) => to));
  for (const node of nodes) {  // a node without predecessors: directly before its first successor
    const next = ways.filter(([from]) => from === node.id).map(([, to]) => layer.get(to));
    if (!entered.has(node.id) && next.length) layer.set(node.id, Math.min(...next) - 1);
  }
  return { layer, ways };
}

function placed(nodes, edges) {
  const { layer, ways } = layersOf(nodes, edges);
  const rows = [];
  const put = (one) => { (rows[one.layer] = rows[one.layer] || []).push(one); return one; };
  const spots = new Map(nodes.map((node) => [node.id, put({ node, layer: layer.get(node.id), near: [[], []] })]));
  const paths = new Map();
  for (const [from, to, edge] of ways) {
    const path = [spots.get(from)];
    for (let at = layer.get(from) + 1; at < layer.get(to); at++) path.push(put({ layer: at, near: [[], []] }));
    path.push(spots.get(to));
    for (let at = 1; at < path.length; at++) {
      path[at - 1].near[1].push(path[at]);
      path[at].near[0].push(path[at - 1]);
    }
    paths.set(edge, from === edge.source ? path : path.reverse());
  }
  const filled = Array.from(rows, (row) => row || []);
  arrange(filled);
  return { spots, paths, rows: filled };
}

const size = (spot) => spot.node ? DOWN : NARROW;
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

function pack(row) {
  // Move spots down until none overlaps the previous one, then up again as far as the row allows.
  let free = -Infinity;
  for (const spot of row) {
    spot.y = Math.max(spot.y, free + size(spot) / 2);
    free = spot.y + size(spot) / 2;
  }
}

function arrange(rows) {
  for (const row of rows) row.forEach((spot, at) => { spot.y = at * DOWN; });
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    const side = sweep % 2;
    const order = side ? [...rows].reverse() : rows;
    for (const row of order) {
      for (const spot of row) {
        const both = sweep > SWEEPS - 4 ? [...spot.near[0], ...spot.near[1]] : spot.near[side];
        spot.want = both.length ? mean(both.map((other) => other.y)) : spot.y;
      }
      row.sort((one, other) => one.want - other.want);
      for (const spot of row) spot.y = spot.want;
      pack(row);
      const shift = row.length ? mean(row.map((spot) => spot.y - spot.want)) : 0;
      for (const spot of row) spot.y -= shift;
    }
  }
  const top = Math.min(...rows.flat().map((spot) => spot.y - size(spot) / 2));
  rows.forEach((row, at) => row.forEach((spot) => { spot.x = at * ACROSS; spot.y -= top; }));
}

function made(name, attributes, text) {
  const element = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export function shortName(label) {
  const plain = label.replace(/^[A-Za-z0-9_]+__0__/, "");
  if (plain.length <= LONGEST) return plain;
  // Of the place of a rule, the line remains: it distinguishes rules with the same name.
  const [, name, line] = plain.match(/^(.*) \([^()]*(:\d+)\)$/) || [plain, plain, ""];
  const space = LONGEST - (line ? line.length + 1 : 0);
  const short = name.length > space ? name.slice(0, space - 1) + "…" : name;
  return line ? `${short} ${line}` : short;
}

function line(path) {
  // From the right side of a node to the left side of the next one, through the dummy positions between them.
  const points = path.map((spot, at) => {
    const half = spot.node ? WIDTH / 2 : 0;
    return [spot.x + (at === 0 ? half : at === path.length - 1 ? -half - 5 : 0), spot.y];
  });
  const back = points[points.length - 1][0] < points[0][0];
  if (back) {
    points[0][0] -= WIDTH;
    points[points.length - 1][0] += WIDTH + 10;
  }
  let d = `M${points[0]}`;
  for (let at = 1; at < points.length; at++) {
    const [x, y] = points[at - 1], [to, down] = points[at];
    const half = (x + to) / 2;
    d += `C${half},${y} ${half},${down} ${to},${down}`;
  }
  return { d, points };
}

function labelAt(edge, edges, points) {
  const into = edges.filter((other) => other.target === edge.target && other.rate).length;
  const last = points[points.length - 1], first = points[0];
  if (into === 1) return { x: last[0] - 2, y: last[1] - 4, "text-anchor": "end" };
  const from = edges.filter((other) => other.source === edge.source && other.rate).length;
  if (from === 1) return { x: first[0] + 3, y: first[1] - 4, "text-anchor": "start" };
  const middle = [(first[0] + points[1][0]) / 2, (first[1] + points[1][1]) / 2];
  return { x: middle[0], y: middle[1] - 3, "text-anchor": "middle" };
}

// Draw a graph into an element; return a function that sets the rates at its edges.
export function draw(graph, place, shown) {
  place.replaceChildren();
  if (!graph.nodes.length) return () => {};
  const there = new Set(graph.nodes.map((node) => node.id));
  const edges = graph.edges.filter((edge) => there.has(edge.source) && there.has(edge.target));
  const { spots, paths, rows } = placed(graph.nodes, edges);
  const wide = (rows.length - 1) * ACROSS + WIDTH + 2 * MARGIN;
  const high = Math.max(...rows.flat().map((spot) => spot.y + size(spot) / 2)) + 2 * MARGIN;
  const scale = Math.max(0.8, Math.min(1, place.clientWidth / wide));
  const svg = made("svg", { viewBox: `${-WIDTH / 2 - MARGIN} ${-MARGIN} ${wide} ${high}`, width: wide * scale,
    height: high * scale, role: "img" });
  const marks = made("defs", {});
  const mark = made("marker", { id: "tip", viewBox: "0 0 8 8", refX: 3, refY: 4, markerWidth: 7, markerHeight: 7,
    orient: "auto", markerUnits: "userSpaceOnUse" });
  mark.append(made("path", { d: "M0,0 L8,4 L0,8 z", class: "arrow" }));
  marks.append(mark);
  svg.append(marks);
  const lively = [];
  const labels = [];
  for (const [edge, path] of paths) {
    const { d, points } = line(path);
    const drawn = made("path", { d, class: `edge ${edge.kind}`, "marker-end": "url(#tip)" });
    svg.append(drawn);
    if (edge.rate) {
      const label = made("text", { ...labelAt(edge, edges, points), class: "rate" });
      labels.push(label);
      lively.push({ edge, drawn, label });
    }
  }
  for (const { node, x, y } of spots.values()) {
    const group = made("g", { transform: `translate(${x},${y})` });
    const round = node.kind === "event" ? HEIGHT / 2 : node.kind === "rule" ? 2 : 6;
    group.append(made("title", {}, node.kind === "rule" ? `${node.label}\n${node.text}` : node.text));
    group.append(made("rect", { x: -WIDTH / 2, y: -HEIGHT / 2, width: WIDTH, height: HEIGHT, rx: round,
      class: `k-${node.kind}` }));
    group.append(made("text", { "text-anchor": "middle", y: 4 }, shortName(node.label)));
    svg.append(group);
  }
  svg.append(...labels);
  place.append(svg);
  return (rates) => {
    for (const { edge, drawn, label } of lively) {
      const rate = rates.get(edge.rate);
      label.textContent = rate === undefined ? "" : shown(rate);
      drawn.classList.toggle("on", rate > 0);
    }
  };
}
