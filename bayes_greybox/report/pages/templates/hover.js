(function () {
  "use strict";
  var LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";

  // A value with the digits that a drawing to a tenth of a point can show of its range.
  function said(value, range) {
    var decimals = Math.max(0, 3 - Math.ceil(Math.log10(range || 1)));
    var text = decimals > 6 ? value.toPrecision(3) : value.toFixed(Math.min(decimals, 6));
    return text.replace(/^-(?=[0.]+$)/, "").replace(/-/g, "−");
  }

  function split(label) {
    var found = /^(.*?) \[(.*)\]$/.exec(label.replace(/\\\$/g, "$"));
    return found ? [found[1], " " + found[2]] : [label, ""];
  }

  // Corners of a drawn line, or its dots, in points from left to right.
  function corners(line) {
    var found = [], x = 0, y = 0;
    line.querySelectorAll("path").forEach(function (path) {
      if (path.closest("defs")) return;
      (path.getAttribute("d").match(/[Ml][^MlhzC]*/g) || []).forEach(function (part) {
        var numbers = part.slice(1).match(/-?(?:\d*\.\d+|\d+)/g) || [];
        for (var i = 0; i + 1 < numbers.length; i += 2) {
          x = +numbers[i] + (part[0] === "l" ? x : 0);
          y = +numbers[i + 1] + (part[0] === "l" ? y : 0);
          found.push([x, y]);
        }
      });
    });
    return found;
  }

  function nearest(points, x) {
    var best = null;
    points.forEach(function (point) {
      if (!best || Math.abs(point[0] - x) < Math.abs(best[0] - x)) best = point;
    });
    return best && Math.abs(best[0] - x) < 12 ? best : null;
  }

  function mapped(map, x, y) {
    var across = map.across, down = map.values.length / 2 / across;
    var i = Math.floor((x - map.x[0]) / (map.x[1] - map.x[0]) * across);
    var j = Math.floor((y - map.y[0]) / (map.y[1] - map.y[0]) * down);
    if (i < 0 || j < 0 || i >= across || j >= down) return null;
    var at = 2 * (j * across + i), span = map.range[1] - map.range[0];
    var step = 64 * LETTERS.indexOf(map.values[at]) + LETTERS.indexOf(map.values[at + 1]);
    return map.range[0] + span * step / 4095;
  }

  function lines(svg, axes, point) {
    var x = axes.x[0] + (point.x - axes.box[0]) / axes.box[2] * (axes.x[1] - axes.x[0]);
    var y = axes.y[0] + (axes.box[1] + axes.box[3] - point.y) / axes.box[3] * (axes.y[1] - axes.y[0]);
    var dx = Math.abs(axes.x[1] - axes.x[0]), dy = Math.abs(axes.y[1] - axes.y[0]);
    var across = split(axes.names[0]), up = split(axes.names[1]);
    var text = [across[0] + " = " + said(x, dx) + across[1]];
    if (axes.map) {
      var value = mapped(axes.map, x, y), name = split(axes.map.name);
      if (value === null) return null;
      text.push(up[0] + " = " + said(y, dy) + up[1]);
      text.push(name[0] + " = " + said(value, Math.max(Math.abs(axes.map.range[0]), Math.abs(axes.map.range[1]))) + name[1]);
      return text;
    }
    Object.keys(axes.lines).forEach(function (id) {
      var line = svg.getElementById(id);
      line.corners = line.corners || corners(line);
      var near = nearest(line.corners, point.x);
      if (near) {
        var at = axes.y[0] + (axes.box[1] + axes.box[3] - near[1]) / axes.box[3] * (axes.y[1] - axes.y[0]);
        text.push(axes.lines[id] + ": " + said(at, dy) + up[1]);
      }
    });
    return text.length > 1 ? text : null;
  }

  document.querySelectorAll("svg.drawing[data-axes]").forEach(function (svg) {
    var all = JSON.parse(svg.dataset.axes), tip = document.createElement("div");
    tip.className = "tip";
    tip.hidden = true;
    tip.setAttribute("aria-hidden", "true");
    document.body.appendChild(tip);
    function hide() { tip.hidden = true; }
    svg.addEventListener("pointerleave", hide);
    ["pointermove", "pointerdown"].forEach(function (kind) {
      svg.addEventListener(kind, function (event) {
        var matrix = svg.getScreenCTM();
        if (!matrix) return;
        var point = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
        var axes = all.find(function (one) {
          return point.x >= one.box[0] && point.x <= one.box[0] + one.box[2] &&
            point.y >= one.box[1] && point.y <= one.box[1] + one.box[3];
        });
        var text = axes && lines(svg, axes, point);
        if (!text) return hide();
        tip.textContent = text.join("\n");
        tip.hidden = false;
        var left = event.pageX + 14, most = window.scrollX + document.documentElement.clientWidth - tip.offsetWidth - 8;
        tip.style.left = Math.max(4, Math.min(left, most)) + "px";
        tip.style.top = event.pageY + 14 + "px";
      });
    });
  });
})();
