"use strict";
// Draws the charts of a report. Their numbers lie in the page in parts that are inflated when they are looked at; long
// columns bring the extremes of their stretches along (levels), so that no view of many samples misses a peak.
(() => {
  const [PART, RAW] = [8192, 32768]; // samples of a part, and in view up to which all are drawn
  const [LEFT, RIGHT, TOP, GAP, AXIS] = [68, 22, 22, 12, 30]; // around panels [px]
  const [root, print] = [document.documentElement, matchMedia("print")];
  const DASHES = [[], [8, 3], [2, 3], [10, 3, 2, 3], [16, 4], [5, 2, 1, 2, 1, 2]];
  const limited = (value, low, high) => Math.min(Math.max(value, low), high);
  const short = (value, digits) => String(Number(value.toPrecision(digits)) + 0).replace("e+", "e").replaceAll("-", "−");

  async function inflated(text) {
    const packed = Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const { writable, readable } = new DecompressionStream("deflate"), writer = writable.getWriter();
    writer.close(writer.write(packed));
    const sorted = new Uint8Array(await new Response(readable).arrayBuffer());
    const [bytes, count] = [new Uint8Array(sorted.length), sorted.length / 4];
    for (let byte = 0; byte < 4; byte++)
      for (let i = 0; i < count; i++) bytes[4 * i + byte] = sorted[byte * count + i];
    return new Float32Array(bytes.buffer);
  }

  const line = (g, from, to) => g.stroke(new Path2D(`M${from}L${to}`));

  // Number of the last of `count` increasing values that is not beyond one, -1 where all are.
  function sought(count, value, at) {
    let [below, above] = [-1, count];
    while (above - below > 1) {
      const middle = (below + above) >> 1;
      if (at(middle) <= value) below = middle;
      else above = middle;
    }
    return below;
  }

  class Column {
    constructor(head, number) {
      Object.assign(this, { levels: [], parts: [], asked: new Set(), number }, head);
      for (const level of this.levels) inflated(level.text).then((numbers) => redrawn((level.numbers = numbers)));
    }

    part = (value) => PART * Math.max(sought(this.bases.length, value, (i) => this.bases[i]), 0); // its first sample

    // Whether the samples from one to another are there; those that are not are fetched.
    ready(first, last) {
      let all = true;
      for (let part = this.step ? Infinity : Math.floor(first / PART); part <= last / PART; part++) {
        all &&= Boolean(this.parts[part]);
        if (this.asked.has(part) || document.readyState === "loading") continue;
        const text = document.getElementById(`column-${this.number}-${part}`)?.textContent;
        if (text) inflated(text).then((numbers) => redrawn((this.parts[part] = numbers)));
        this.asked.add(part);
      }
      return all;
    }

    at(i) {
      if (this.step) return this.start + this.step * i;
      const part = Math.floor(i / PART);
      return this.bases[part] + this.scale * this.parts[part][i % PART];
    }

    // Lowest (0) or highest (1) of a stretch of a level of columns as long as this one.
    extreme(width, i, which) {
      if (this.step) return this.at(i * width);
      const level = this.levels.find((one) => one.width === width);
      return level.numbers ? level.base + level.scale * level.numbers[2 * i + which] : NaN;
    }

    // Number of the last sample of an increasing column that is not beyond a value, -1 before all.
    index(value) {
      if (this.step) return limited(Math.floor((value - this.start) / this.step + 1e-9), -1, this.count - 1);
      const first = this.part(value);
      const last = Math.min(first + PART, this.count) - 1;
      if (this.ready(first, last)) return first + sought(last - first + 1, value, (i) => this.at(first + i));
      const level = this.levels.find((one) => one.numbers);
      return level ? level.width * sought(level.numbers.length / 2, value, (i) => this.extreme(level.width, i, 0)) : -1;
    }
  }

  // An axis from one value to another over pixels.
  function scaled(from, to, start, stop, log) {
    const f = log ? Math.log10 : (value) => value;
    const ratio = (stop - start) / (f(to) - f(from));
    const value = (px) => (log ? 10 ** (f(from) + (px - start) / ratio) : from + (px - start) / ratio);
    return { from, to, log, value, px: (at) => start + (f(at) - f(from)) * ratio };
  }

  // About `room` values of an axis, with their texts.
  function ticks({ from, to, log }, room) {
    const found = [];
    if (log && to / from > 8) {
      const decades = Math.log10(to / from);
      for (let power = Math.floor(Math.log10(from)); power <= Math.log10(to); power++)
        for (const digit of decades * 3 <= room ? [1, 2, 5] : power % Math.ceil(decades / room) ? [] : [1])
          found.push(Number(`${digit}e${power}`));
      return found.filter((value) => value >= from && value <= to).map((value) => [value, short(value, 6)]);
    }
    const rough = (to - from) / room, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find((_, n) => rough / power < [1.41, 3.16, 7.07, 11][n]) * power; // the nearest
    for (let i = Math.ceil(from / step - 1e-9); i * step <= to + 1e-9 * step; i++) found.push(i * step);
    const digits = limited(Math.ceil(Math.log10(Math.max(Math.abs(from), Math.abs(to)) / step)) + 1, 1, 15);
    return found.map((value) => [value, short(value, digits)]);
  }

  // What is in view of a curve: (x [px], lowest, highest) in threes, one or more samples each; and the extremes of all.
  function points(xs, ys, rising, scale) {
    const found = { drawn: [], lowest: Infinity, highest: -Infinity, rough: false };
    const put = (x, lowest, highest) => {
      const { drawn } = found, end = drawn.length, px = scale.px(x);
      if (x >= scale.from && x <= scale.to) {
        if (lowest < found.lowest) found.lowest = lowest;
        if (highest > found.highest) found.highest = highest;
      }
      const apart = !rising || !end || Math.round(px) !== Math.round(drawn[end - 3]) || Number.isNaN(drawn[end - 2]);
      if (apart) return drawn.push(px, lowest, highest);
      if (lowest < drawn[end - 2]) drawn[end - 2] = lowest;
      if (highest > drawn[end - 1]) drawn[end - 1] = highest;
    };
    const ends = rising && !xs.step ? [scale.from, scale.to].map(xs.part) : [0, Infinity];
    if (ends[1] - ends[0] < RAW) ys.ready(...ends); // fetched beside the instants, which tell what of it is in view
    const first = rising ? Math.max(xs.index(scale.from), 0) : 0;
    const last = rising ? Math.min(xs.index(scale.to) + 1, ys.count - 1) : ys.count - 1;
    found.samples = last - first;
    if ((last - first < RAW || !ys.levels.length) && xs.ready(first, last) && ys.ready(first, last)) {
      for (let i = first; i <= last; i++) put(xs.at(i), ys.at(i), ys.at(i));
      return found;
    }
    const level = ys.levels.find((one) => one.numbers && (last - first) / one.width < RAW);
    found.rough = !level || last - first < RAW;
    for (let i = Math.floor(first / level?.width), of = level?.width; i <= last / of; i++)
      put(xs.extreme(of, i, 0), ys.extreme(of, i, 0), ys.extreme(of, i, 1));
    return found;
  }

  class Chart {
    constructor(host) {
      Object.assign(this, { host, hidden: new Set() }, JSON.parse(host.querySelector("script").textContent));
      [this.canvas, this.hair, this.box, this.readout] = host.querySelector(".frame").children;
      for (const button of host.querySelectorAll("button"))
        button.onclick = () => {
          const [label, shown] = [button.textContent, button.getAttribute("aria-pressed") === "true"];
          this.hidden[shown ? "add" : "delete"](label);
          this.draw(button.setAttribute("aria-pressed", String(!shown)));
        };
      this.listen(this.whole());
    }

    whole() {
      [[this.from, this.to], this.fit] = [this.range, this.equal];
      this.leave();
    }

    // Draws what is in view, at the resolution of a screen or of paper.
    draw() {
      const sharpness = root.classList.contains("paper") || print.matches ? 3 : Math.max(devicePixelRatio, 1);
      this.width = this.canvas.parentElement.clientWidth;
      if (this.width < 2 * LEFT) return;
      const colours = getComputedStyle(root);
      this.colour = (name) => colours.getPropertyValue(`--${name}`);
      const [canvas, tall, g] = [this.canvas, this.height * this.panels.length + AXIS, this.canvas.getContext("2d")];
      [canvas.width, canvas.height] = [Math.round(this.width * sharpness), Math.round(tall * sharpness)];
      canvas.style.aspectRatio = `${this.width} / ${tall}`;
      g.setTransform(sharpness, 0, 0, sharpness, 0, 0);
      g.font = `12px ${getComputedStyle(this.host).fontFamily}`;
      if (this.fit) {
        const [low, high] = this.upright, [wide, tall] = [this.width - LEFT - RIGHT, this.height - TOP - GAP];
        const missing = Math.max(((high - low) * wide) / tall - (this.to - this.from), 0); // for all to be in the plane
        [this.from, this.to] = [this.from - missing / 2, this.to + missing / 2];
        [this.middle, this.fit] = [(low + high) / 2, false];
      }
      this.scale = scaled(this.from, this.to, LEFT, this.width - RIGHT, this.logX);
      this.rough = false;
      this.panels.forEach((panel, number) => this.drawPanel(g, panel, number));
      const panels = this.panels.map((panel) => panel.seen);
      this.canvas.dataset.view = JSON.stringify({ from: this.from, to: this.to, rough: this.rough, panels });
    }

    drawPanel(g, panel, number) {
      const [top, bottom] = [number * this.height + TOP, (number + 1) * this.height - GAP];
      const shown = (one) => !this.hidden.has(one.label);
      const view = (one, y) => points(columns[one.x], columns[y], one.rising ?? true, this.scale);
      const bands = panel.bands.filter(shown).map((one) => [view(one, one.lower), view(one, one.upper)]);
      const curves = panel.curves.filter(shown).map((one) => [one, view(one, one.y)]);
      const all = [...curves.map(([, found]) => found), ...bands.flat()];
      this.rough ||= all.some((found) => found.rough);
      const y = scaled(...this.upwards(panel, all, bottom - top), bottom, top, panel.log);
      const seen = curves.map(([one, found]) => [one.label, found.lowest, found.highest]);
      Object.assign(panel, { top, bottom, y, seen });
      this.drawAxes(g, panel, number === this.panels.length - 1);
      g.save();
      g.clip(new Path2D(`M${LEFT} ${top}H${this.width - RIGHT}V${bottom}H${LEFT}Z`));
      g.fillStyle = this.colour("band");
      for (const [{ drawn: lower }, { drawn: upper }] of bands) {
        g.beginPath();
        for (let i = 0; i < upper.length; i += 3) g.lineTo(upper[i], y.px(upper[i + 2]));
        for (let i = lower.length - 3; i >= 0; i -= 3) g.lineTo(lower[i], y.px(lower[i + 1]));
        g.fill();
      }
      for (const mark of panel.marks) this.drawMark(g, panel, mark);
      for (const [one, found] of curves) this.drawCurve(g, y, one, found);
      g.restore();
    }

    // Lowest and highest of the vertical axis of a panel.
    upwards(panel, all, tall) {
      const half = (((this.to - this.from) / (this.width - LEFT - RIGHT)) * tall) / 2;
      if (this.equal) return [this.middle - half, this.middle + half];
      if (panel.range) return panel.range;
      let [low, high] = [Math.min(...all.map((one) => one.lowest)), Math.max(...all.map((one) => one.highest))];
      if (panel.log) low = Math.max(low, high * 1e-18);
      if (!(low <= high)) [low, high] = [1, 1];
      const near = panel.marks.filter(({ y }) => Math.max(high, y) - Math.min(low, y) <= 4 * (high - low));
      [low, high] = [Math.min(low, ...near.map(({ y }) => y)), Math.max(high, ...near.map(({ y }) => y))];
      if (panel.log) return [low / (high / low) ** 0.06 / 1.1, high * (high / low) ** 0.06 * 1.1];
      const slack = high - low > 1e-12 * Math.abs(high) ? 0.06 * (high - low) : Math.abs(high) * 0.1 || 1;
      return [low - slack, high + slack];
    }

    drawAxes(g, { top, bottom, y, title }, last) {
      const right = this.width - RIGHT;
      [g.lineWidth, g.strokeStyle, g.fillStyle] = [1, this.colour("grid"), this.colour("soft")];
      [g.textAlign, g.textBaseline] = ["right", "middle"];
      for (const [value, text] of ticks(y, (bottom - top) / 34)) {
        line(g, [LEFT, Math.round(y.px(value)) + 0.5], [right, Math.round(y.px(value)) + 0.5]);
        g.fillText(text, LEFT - 7, y.px(value));
      }
      g.textAlign = "center";
      for (const [value, text] of ticks(this.scale, this.width / 110)) {
        const px = Math.round(this.scale.px(value)) + 0.5;
        line(g, [px, top], [px, bottom]);
        if (last) g.fillText(text, px, bottom + 11);
      }
      g.strokeStyle = this.colour("line");
      g.strokeRect(LEFT + 0.5, top + 0.5, right - LEFT, bottom - top);
      if (last) g.fillText(this.x, (LEFT + right) / 2, bottom + 29);
      [g.textAlign, g.fillStyle] = ["left", this.colour("ink")];
      g.fillText(title, LEFT, top - 9, right - LEFT);
    }

    drawCurve(g, y, { tone, colour, style }, { drawn, samples }) {
      g.setLineDash({ measured: [], reference: [5, 4] }[tone] ?? DASHES[(colour + Math.floor(colour / 6)) % 6]);
      g.strokeStyle = g.fillStyle = this.colour(tone === "data" ? `c${colour % 6}` : tone);
      [g.lineWidth, g.lineJoin] = [tone === "measured" ? 3.2 : 1.5, "round"];
      const joined = style === "line" || style === "steps";
      if (joined) trace(g, y, drawn, style === "steps");
      g.setLineDash([]);
      if (joined && (tone !== "data" || samples > this.width / 8)) return; // else each sample gets its dot
      for (let i = 0; i < drawn.length; i += 3) {
        if (style === "stems") line(g, [drawn[i], y.px(0)], [drawn[i], y.px(drawn[i + 1])]);
        if (!Number.isNaN(drawn[i + 1])) sign(g, style, drawn[i], y.px(drawn[i + 1]));
      }
    }

    drawMark(g, { top, bottom, y }, mark) {
      const [x, up, [from, to]] = [this.scale.px(mark.x), y.px(mark.y), mark.span ?? []];
      g.strokeStyle = g.fillStyle = this.colour(mark.wrong ? "error" : "soft");
      [g.lineWidth, g.textBaseline, g.textAlign] = [1.4, "bottom", mark.x === undefined ? "right" : "left"];
      g.setLineDash(mark.x === undefined || mark.y === undefined ? [5, 4] : []);
      const [start, stop] = [from ?? this.from, to ?? this.to].map(this.scale.px);
      if (mark.y === undefined) line(g, [x, y.px(from ?? y.from)], [x, y.px(to ?? y.to)]);
      else if (mark.x === undefined) line(g, [start, up], [stop, up]);
      else sign(g, "crosses", x, up);
      const place = mark.x === undefined ? Math.min(stop, this.width - RIGHT) - 6 : x + 6;
      g.fillText(mark.label, place, mark.y === undefined ? top + 16 : up < top + 16 ? up + 16 : up - 3);
    }

    zoom(from, to) {
      const least = 1e-12 * Math.max(Math.abs(from), Math.abs(to), 1e-12);
      if (!(to - from > least) || (this.logX && from <= 0)) return;
      [this.from, this.to] = [from, to];
      this.draw(this.leave());
    }

    // Moves the view by a share of it, and changes its width by a factor about a place [px].
    move(share, factor = 1, place = (LEFT + this.width - RIGHT) / 2) {
      const span = this.width - LEFT - RIGHT, start = place - (place - LEFT) * factor + share * span;
      this.zoom(this.scale.value(start), this.scale.value(start + span * factor));
    }

    listen() {
      const canvas = this.canvas;
      let begun = null;
      canvas.onpointerdown = (event) => {
        if (event.button || event.pointerType === "touch") return; // fingers scroll the page
        begun = { x: event.offsetX, y: event.offsetY, shift: event.shiftKey, scale: this.scale, middle: this.middle };
        canvas.setPointerCapture(event.pointerId);
      };
      canvas.onpointermove = ({ offsetX: x, offsetY: y }) => {
        if (!begun) return this.point(x, y);
        if (!begun.shift) {
          const [left, width] = [Math.min(x, begun.x), Math.abs(x - begun.x)];
          return Object.assign(this.box.style, { left: `${left}px`, width: `${width}px`, display: "block" });
        }
        const up = this.panels[0].y;
        this.middle = begun.middle + up.value(begun.y) - up.value(y);
        this.zoom(begun.scale.value(LEFT + begun.x - x), begun.scale.value(this.width - RIGHT + begun.x - x));
      };
      canvas.onpointerup = ({ offsetX: x, offsetY: y }) => {
        const from = begun;
        begun = null;
        this.box.style.display = "none";
        if (!from || from.shift || Math.abs(x - from.x) < 4) return;
        this.middle = this.panels[0].y.value((y + from.y) / 2);
        const ends = [Math.min(x, from.x), Math.max(x, from.x)].map((px) => limited(px, LEFT, this.width - RIGHT));
        this.zoom(...ends.map(this.scale.value));
      };
      [canvas.onpointerleave, canvas.ondblclick] = [() => this.leave(), () => this.draw(this.whole())];
      canvas.onwheel = (event) => {
        if (!event.ctrlKey && !event.metaKey) return; // a page with charts still scrolls
        event.preventDefault();
        const factor = Math.exp(limited(event.deltaY, -200, 200) / 400), up = this.panels[0].y.value(event.offsetY);
        this.middle = up + (this.middle - up) * factor;
        this.move(0, factor, event.offsetX);
      };
      canvas.onkeydown = (event) => {
        const read = (by) => this.point((this.read ?? (LEFT + this.width - RIGHT) / 2) + by, TOP);
        const [go, widen] = [(by) => (event.shiftKey ? read(by) : this.move(0.2 * by)), (by) => this.move(0, by)];
        const zooms = { "+": () => widen(0.5), "=": () => widen(0.5), "-": () => widen(2), 0: canvas.ondblclick };
        const arrows = { ArrowLeft: () => go(-1), ArrowRight: () => go(1), Escape: () => this.leave() };
        const action = { ...zooms, ...arrows }[event.key];
        if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        action();
      };
    }

    // Tells the values at a place, of each curve the nearest sample.
    point(px, py) {
      if (px < LEFT || px > this.width - RIGHT) return this.leave();
      const x = this.scale.value(px), rows = [`${this.x}: ${short(x, 9)}`];
      if (this.equal) rows.push(`${this.panels[0].title}: ${short(this.panels[0].y.value(py), 6)}`);
      for (const [panel, one] of this.panels.flatMap((panel) => panel.curves.map((one) => [panel, one]))) {
        if (!one.rising || this.hidden.has(one.label)) continue;
        const [xs, ys] = [columns[one.x], columns[one.y]], i = xs.index(x), next = Math.min(i + 1, xs.count - 1);
        if (i < 0 || !xs.ready(i, next) || !ys.ready(i, next)) continue;
        const near = one.style !== "steps" && xs.at(next) - x < x - xs.at(i) ? next : i;
        rows.push(`${panel.title}${this.legend ? `, ${one.label}` : ""}: ${short(ys.at(near), 7)}`);
      }
      this.read = px;
      this.readout.textContent = rows.slice(0, 16).join("\n");
      Object.assign(this.hair.style, { left: `${px}px`, display: "block" });
      const [left, right] = px > this.width / 2 ? ["", `${this.width - px + 12}px`] : [`${px + 12}px`, ""];
      Object.assign(this.readout.style, { left, right, display: "block" });
    }

    leave() {
      this.read = undefined;
      for (const one of [this.hair, this.box, this.readout]) one.style.display = "none";
    }
  }

  // A line through points; of one that is a stretch, through its nearer end first. Values that are none leave a gap.
  function trace(g, y, drawn, steps) {
    let before = NaN;
    g.beginPath();
    for (let i = 0; i < drawn.length; i += 3) {
      let [first, second] = [y.px(drawn[i + 1]), y.px(drawn[i + 2])];
      if (Math.abs(second - before) < Math.abs(first - before)) [first, second] = [second, first];
      if (Number.isNaN(before)) g.moveTo(drawn[i], first);
      else if (steps) g.lineTo(drawn[i], before);
      g.lineTo(drawn[i], first);
      if (second !== first) g.lineTo(drawn[i], second);
      before = second;
    }
    g.stroke();
  }

  function sign(g, style, x, y) {
    if (style === "crosses") return [-4, 4].forEach((r) => line(g, [x - 4, y - r], [x + 4, y + r]));
    g.beginPath();
    g.arc(x, y, style === "circles" ? 4 : 2.2, 0, 7);
    g[style === "circles" ? "stroke" : "fill"]();
  }

  const columns = JSON.parse(document.getElementById("columns").textContent).map((head, i) => new Column(head, i));
  const hosts = [...document.querySelectorAll(".chart")];
  for (const host of hosts) host.chart = new Chart(host);
  const near = new Set(); // charts at or near what is seen of the page
  let waiting = false;

  // Draws again what had to be drawn without numbers that are there now.
  function redrawn() {
    if (!waiting) requestAnimationFrame(() => (waiting = near.forEach((chart) => chart.rough && chart.draw())));
    waiting = true;
  }

  const all = () => hosts.forEach(({ chart }) => chart.draw());
  const paper = (on) => () => all(root.classList.toggle("paper", on));
  const met = ({ target: { chart }, isIntersecting }) => {
    near[isIntersecting ? "add" : "delete"](chart);
    if (isIntersecting) chart.draw();
  };
  const eyes = new IntersectionObserver((entries) => entries.forEach(met), { rootMargin: "400px" });
  const sizes = new ResizeObserver((all) => all.forEach(({ target: { chart } }) => near.has(chart) && chart.draw()));
  for (const host of hosts) [eyes, sizes].forEach((observer) => observer.observe(host));
  for (const query of [matchMedia("(prefers-color-scheme: dark)"), print]) query.addEventListener("change", all);
  [onbeforeprint, onafterprint] = [paper(true), paper(false)];
  onload = () => redrawn(columns.forEach((one) => one.levels.length || one.ready(0, one.count - 1))); // also for paper
})();
