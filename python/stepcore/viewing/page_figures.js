// The figures beside a replay, and their curves over time.
"use strict";
function figureSheet(runs, gaps, colours, { begin, end }, byId) {
  const labelOf = (k) => runs[k].label || `run ${k + 1}`;
  const number = (x) => (Math.abs(x) >= 1e4 || (x !== 0 && Math.abs(x) < 1e-3)
    ? x.toExponential(2) : x.toPrecision(4));

  function figures(frame) {
    const rows = [];
    const run = runs[0];
    const [kinetic, potential] = run.energy.subarray(2 * frame, 2 * frame + 2);
    rows.push(["kinetic energy", `${number(kinetic)} J`]);
    rows.push(["potential energy", `${number(potential)} J`]);
    rows.push(["total", `${number(kinetic + potential)} J`]);
    rows.push(["contacts with force", run.starts[frame + 1] - run.starts[frame]]);
    rows.push(["residual", `${run.residual[frame].toExponential(1)} m/s`]);
    gaps.forEach((gap, k) => {
      // Where the other run has ended nothing is compared.
      const apart = Number.isNaN(gap[frame]) ? "–" : `${number(1000 * gap[frame])} mm`;
      rows.push([`distance of ${labelOf(k + 1)}`, apart]);
    });
    byId("figures").replaceChildren(...rows.map((cells) => {
      const row = document.createElement("tr");
      for (const cell of cells) row.insertCell().textContent = cell;
      return row;
    }));
  }

  // What can be chosen to be drawn over time.
  const CURVES = {
    distance: () => gaps.map((gap, k) => ({
      values: Array.from(gap, (x) => 1000 * x), colour: cssOf(runs[k + 1].tint),
      name: `distance of ${labelOf(k + 1)} [mm]`,
    })),
    energy: () => {
      const energy = Array.from(runs[0].energy);
      const kinetic = energy.filter((_, i) => i % 2 === 0);
      const potential = energy.filter((_, i) => i % 2 === 1);
      const total = kinetic.map((x, i) => x + potential[i]);
      // Potential energy has no zero of its own.
      const since = (values) => values.map((x) => x - values[0]);
      return [
        { name: "kinetic [J]", colour: colours.kinetic, values: kinetic },
        { name: "Δ potential", colour: colours.potential, values: since(potential) },
        { name: "Δ total", colour: colours.total, values: since(total) },
      ];
    },
    residual: () => [{
      name: "log10 of the residual in m/s", colour: colours.residual,
      values: Array.from(runs[0].residual, (x) => Math.log10(Math.max(x, 1e-20))),
    }],
  };
  const cssOf = (tint) => `rgb(${tint.map((c) => Math.round(255 * c)).join()})`;
  let drawn = [];
  let least = 0;
  let most = 1;
  let shown = begin;

  function choose() {
    drawn = CURVES[byId("curve").value]();
    byId("legend").innerHTML = drawn
      .map((c) => `<span><i class="key" style="background:${c.colour}"></i></span>`).join("");
    drawn.forEach((c, k) => byId("legend").children[k].append(c.name));
    const every = drawn.flatMap((c) => c.values).filter(Number.isFinite);
    least = every.reduce((a, b) => Math.min(a, b), 0);
    most = every.reduce((a, b) => Math.max(a, b), byId("curve").value === "residual" ? -1e300 : 0);
  }
  const names = Object.keys(CURVES).filter((name) => name !== "distance" || gaps.length);
  byId("curve").innerHTML = names.map((name) => `<option>${name}</option>`).join("");
  choose();
  byId("curve").onchange = () => {
    choose();
    plot(shown);
  };

  function plot(now) {
    shown = now;
    const sheet = byId("plot");
    const pen = sheet.getContext("2d");
    const { width, height } = sheet;
    pen.clearRect(0, 0, width, height);
    const x = (time) => ((time - begin) / (end - begin || 1)) * (width - 4) + 2;
    const y = (value) => height - 6 - ((value - least) / (most - least || 1)) * (height - 12);
    pen.strokeStyle = "#8886";
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(0, y(0));
    pen.lineTo(width, y(0));
    pen.stroke();
    pen.lineWidth = 3;
    for (const { values, colour } of drawn) {
      pen.strokeStyle = colour;
      pen.beginPath();
      values.forEach((value, i) => {
        if (Number.isFinite(value)) pen.lineTo(x(runs[0].time[i]), y(value));
      });
      pen.stroke();
    }
    // The ends of the axis, which stay readable over the curves.
    const { color, backgroundColor } = getComputedStyle(document.querySelector("aside"));
    pen.font = "20px system-ui, sans-serif";
    pen.textAlign = "right";
    pen.lineWidth = 6;
    pen.strokeStyle = backgroundColor;
    pen.fillStyle = color;
    for (const [value, at] of [[most, 20], [least, height - 8]]) {
      pen.strokeText(number(value), width - 4, at);
      pen.fillText(number(value), width - 4, at);
    }
    pen.strokeStyle = colours.force;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x(now), 0);
    pen.lineTo(x(now), height);
    pen.stroke();
  }

  return { figures, plot, labelOf, number, cssOf };
}
