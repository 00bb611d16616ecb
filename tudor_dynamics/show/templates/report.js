/* Draws the figures of a report: each is a figure element with its data as JSON.
   Colours of text and grids come from report.css, so that dark, light and paper need no script. */
(function () {
  'use strict';
  const GAP = {left: 58, right: 14, top: 26, bottom: 44};
  const LEAST = 250;  // width of a panel [px]
  const LOOKS = {
    measured: {color: '#9a9a9a', width: 3}, analytical: {color: '#2a86cf', width: 1.3},
    elm: {color: '#e0702a', width: 1.3, dash: '5px,2px'},
    elastic: {color: '#1f9e77', width: 1.6, dash: '2px,1.5px'},
    other: {color: '#2a86cf', width: 1.5, dash: '4px,2px'},
    fill: {color: '#9a9a9a', width: 0.5, fill: 'rgba(150,150,150,.45)'},
    limit: {color: '#8a8a8a', width: 1, dash: '4px,3px'},
    link: {color: '#8a97a8', width: 9}, others: {color: '#9a9a9a', width: 1},
    joint: {color: '#5a6675', symbol: 'circle', size: 11},
    gauge: {color: '#e0702a', symbol: 'diamond', size: 11},
    event: {color: '#e0702a', symbol: 'triangle-down', size: 11},
    dots: {color: '#2a86cf', symbol: 'circle', size: 3.5},
    ring: {color: '#ffffff', symbol: 'circle', size: 7, edge: '#222222'},
    held: {color: '#2a86cf', symbol: 'circle-open', size: 8},
    moved: {color: '#e0702a', symbol: 'x-thin-open', size: 8}
  };
  const CYCLE = ['#e0702a', '#2a86cf', '#1f9e77', '#9068c0', '#b0803c', '#cc79a7'];
  const SYMBOLS = ['circle', 'square', 'diamond', 'triangle-up', 'triangle-down', 'cross'];
  CYCLE.forEach((color, k) => { LOOKS['arm' + k] = {color, width: 1.6, symbol: SYMBOLS[k], size: 7}; });
  const WORDS = {elm: 'ELM'};
  const STEPS = [];
  for (let e = -4; e < 5; e++) for (const d of [1, 2, 5]) STEPS.push(+(d * Math.pow(10, e)).toPrecision(2));

  function decode(text) {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }
  const escaped = text => String(text).replace(/&/g, '&amp;').replace(/</g, '&lt;').replace(/>/g, '&gt;');

  function drawing(content, width) {
    const data = {};
    for (const [name, text] of Object.entries(content.data || {})) data[name] = decode(text);
    const values = v => (typeof v === 'string' ? data[v] : v);
    const columns = Math.max(1, Math.min(content.columns, Math.floor(width / LEAST),
                                         content.half ? 2 : content.panels.length));
    const rows = Math.ceil(content.panels.length / columns);
    const heights = [];
    for (let row = 0; row < rows; row++) {
      heights.push(Math.max(...content.panels.slice(row * columns, (row + 1) * columns)
        .map(p => p.height || 190)));
    }
    const names = new Set();
    const traces = [], annotations = [], shapes = [], layout = {};
    const wide = (width - columns * (GAP.left + GAP.right)) / columns;
    const titled = row => content.panels.slice(row * columns, (row + 1) * columns).some(p => p.title);
    const labelled = row => content.panels.slice(row * columns, (row + 1) * columns).some(p => p.xlabel);
    const tops = [];
    let y = 0;
    for (let row = 0; row < rows; row++) {
      y += titled(row) ? GAP.top : 8;
      tops.push(y);
      y += heights[row] + (labelled(row) ? GAP.bottom : 6);
    }
    const total = y;
    content.panels.forEach((panel, k) => {
      const n = k ? String(k + 1) : '', row = Math.floor(k / columns), column = k % columns;
      const left = column * (wide + GAP.left + GAP.right);
      // the plot area begins at the first axis and ends at the last
      const area = width - GAP.left - GAP.right;
      const x0 = left / area, x1 = Math.min(1, (left + wide) / area);
      const top = tops[row], bottom = top + (panel.height || heights[row]);
      const high = total - tops[0] - (labelled(rows - 1) ? GAP.bottom : 6);
      const y1 = 1 - (top - tops[0]) / high, y0 = Math.max(0, 1 - (bottom - tops[0]) / high);
      const heat = panel.traces.find(t => t.look === 'map' && !t.plain);
      const xaxis = {domain: [x0, heat ? x1 - 62 / area : x1], anchor: 'y' + n,
                     title: {text: escaped(panel.xlabel), standoff: 6}, zeroline: false,
                     automargin: false, nticks: wide < 300 ? 5 : 0};
      const yaxis = {domain: [y0, y1], anchor: 'x' + n, title: {text: escaped(panel.ylabel), standoff: 4},
                     zeroline: true, nticks: 6};
      if (content.linked && k) xaxis.matches = 'x';
      if (content.linked && !panel.xlabel) xaxis.showticklabels = false;
      for (const axis of {log: [xaxis, yaxis], 'log y': [yaxis]}[panel.scale] || []) {
        Object.assign(axis, {type: 'log', tickvals: STEPS, ticktext: STEPS.map(String)});
      }
      if (panel.xlim) xaxis.range = panel.xlim;
      if (panel.ylim) yaxis.range = yaxis.type === 'log' ? panel.ylim.map(Math.log10) : panel.ylim;
      if (panel.low !== undefined) yaxis.rangemode = 'tozero';
      if (panel.equal) { yaxis.scaleanchor = 'x' + n; yaxis.scaleratio = 1; }
      layout['xaxis' + n] = xaxis;
      layout['yaxis' + n] = yaxis;
      if (panel.title) {
        annotations.push({text: '<b>' + escaped(panel.title) + '</b>', showarrow: false, xref: 'paper',
                          yref: 'paper', x: x0, y: y1, xanchor: 'left', yanchor: 'bottom', font: {size: 12}});
      }
      for (const [begin, end, word] of panel.spans || []) {
        shapes.push({type: 'rect', xref: 'x' + n, yref: 'y' + n + ' domain', x0: begin, x1: end, y0: 0, y1: 1,
                     fillcolor: 'rgba(240,200,40,.35)', line: {width: 0}, layer: 'below'});
        annotations.push({text: escaped(word), showarrow: false, xref: 'x' + n, yref: 'y' + n + ' domain',
                          x: begin, y: 0, xanchor: 'left', yanchor: 'bottom', font: {size: 11}});
      }
      if (panel.at !== undefined) {
        shapes.push({type: 'line', xref: 'x' + n + ' domain', yref: 'y' + n, x0: 0, x1: 1, y0: panel.at,
                     y1: panel.at, line: {color: '#8a8a8a', width: 1.2, dash: 'dash'}});
      }
      for (const item of panel.traces) {
        const look = LOOKS[item.look] || {color: '#9068c0', width: 1.4, dash: '6px,1px'};
        const name = WORDS[item.name] || item.name;
        const x = values(item.x), y = values(item.y);
        const base = {xaxis: 'x' + n, yaxis: 'y' + n, name: escaped(name), legendgroup: name,
                      showlegend: Boolean(name) && !names.has(name)};
        if (item.look === 'map') {
          const flat = values(item.z), z = [], shown = [], width_ = x.length - 1;
          const known = Array.from(flat).filter(Number.isFinite);
          const low = Math.min(...known), top_ = Math.max(...known);
          const logarithmic = !item.plain && low > 0 && top_ > 4 * low;
          for (let r = 0; r < y.length - 1; r++) {
            const line = Array.from(flat.slice(r * width_, (r + 1) * width_),
                                    v => (Number.isFinite(v) ? v : null));
            shown.push(line);
            z.push(logarithmic ? line.map(v => (v === null ? null : Math.log10(v))) : line);
          }
          const bar = {x: x1 - 56 / area, xanchor: 'left', y: (y0 + y1) / 2, len: y1 - y0, thickness: 11,
                       outlinewidth: 0, tickfont: {size: 10}};
          if (logarithmic) {
            bar.tickvals = [];
            bar.ticktext = [];
            for (const v of STEPS.filter(v => v >= low * .999 && v <= top_ * 1.001)) {
              bar.tickvals.push(Math.log10(v));
              bar.ticktext.push(String(v));
            }
          }
          traces.push({...base, type: 'heatmap', x, y, z, customdata: shown, showlegend: false,
                       colorscale: item.plain ? [[0, '#cfcfcf'], [1, '#6e6e6e']] : 'Cividis',
                       reversescale: !item.plain, showscale: !item.plain, colorbar: bar,
                       hovertemplate: item.plain ? '%{x:.3g}, %{y:.3g}<extra></extra>' :
                         '%{x:.3g}, %{y:.3g}: %{customdata:.3g}<extra></extra>'});
          continue;
        }
        names.add(name);
        if (item.low) {
          const edge = {...base, x, mode: 'lines', line: {width: 0, shape: 'hv'}, hoverinfo: 'skip',
                        showlegend: false};
          traces.push({...edge, y: values(item.low)},
                      {...edge, y: values(item.high), fill: 'tonexty',
                       fillcolor: look.color + '26'});
        }
        const trace = {...base, type: 'scatter', x, y, connectgaps: false};
        const marked = look.symbol || item.points;
        trace.mode = !look.width || (item.across && marked) ? 'markers' : marked ? 'lines+markers' : 'lines';
        if (look.width) {
          trace.line = {color: look.color, width: look.width, dash: look.dash,
                        shape: item.stairs ? 'hv' : 'linear', simplify: true};
        }
        if (look.fill) { trace.fill = 'tozeroy'; trace.fillcolor = look.fill; }
        if (marked) {
          trace.marker = {color: look.color, symbol: look.symbol || 'circle', size: look.size || (item.across ? 11 : 5),
                          line: {width: look.edge ? 1.2 : look.width === undefined && look.symbol && look.symbol.endsWith('open') ? 1.5 : 0,
                                 color: look.edge || look.color}};
        }
        if (item.text) {
          trace.text = item.text.map(escaped);
          trace.hovertemplate = '%{text}<extra></extra>';
          if (item.look !== 'event') { trace.mode = 'markers+text'; trace.textposition = item.look === 'gauge' ? 'bottom right' : 'top left'; }
        } else {
          trace.hovertemplate = '%{x:.4~g}, %{y:.4~g}';
          if (Array.isArray(x)) trace.hovertemplate = '%{x}, %{y:.4~g}';
        }
        if (item.error) trace.error_y = {array: values(item.error), thickness: .8, width: 2, color: look.color};
        if (item.across) {
          const [low, high] = item.across;
          trace.error_x = {array: [high - x[0]], arrayminus: [x[0] - low], type: 'data', symmetric: false,
                           color: look.color, thickness: 1.5};
        }
        traces.push(trace);
      }
    });
    if (content.stretch) {
      content.panels.forEach((_, k) => shapes.push({
        type: 'rect', xref: k ? 'x' + (k + 1) : 'x', yref: (k ? 'y' + (k + 1) : 'y') + ' domain',
        x0: content.stretch[0], x1: content.stretch[1], y0: 0, y1: 1, line: {width: 0}, layer: 'below',
        fillcolor: 'rgba(240,200,40,.18)'}));
    }
    const legend = names.size > 1 || (names.size === 1 && content.panels.length > 1);
    const chars = Array.from(names).reduce((sum, name) => sum + name.length * 6.5 + 46, 0);
    const above = 24 + (legend ? 20 * Math.max(1, Math.ceil(chars / (width - 20))) + 4 : 0);  // tools, legend
    const margin = {l: GAP.left, r: GAP.right, t: tops[0] + above, b: labelled(rows - 1) ? GAP.bottom : 6};
    return {traces, layout: {
      ...layout, annotations, shapes, margin, width, height: total + above, showlegend: legend,
      legend: {orientation: 'h', x: 0, xanchor: 'left', y: 1 + tops[0] / (total - tops[0] - margin.b),
               yanchor: 'bottom', font: {size: 12}, bgcolor: 'rgba(0,0,0,0)'},
      font: {family: 'system-ui, sans-serif', size: 11}, hovermode: 'closest',
      paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
      dragmode: matchMedia('(pointer: coarse)').matches ? false : 'zoom'}};
  }

  const SETTINGS = {displaylogo: false, responsive: false, doubleClick: 'reset',
                    modeBarButtons: [['zoom2d', 'pan2d', 'zoomIn2d', 'zoomOut2d', 'resetScale2d', 'toImage']]};
  function draw(figure) {
    const place = figure.querySelector('.canvas'), width = place.clientWidth;
    if (!width || figure.drawn === width) return;
    const content = figure.content ||
      (figure.content = JSON.parse(figure.querySelector('script').textContent));
    const made = drawing(content, width);
    if (!figure.drawn) place.textContent = '';
    figure.drawn = width;
    Plotly.react(place, made.traces, made.layout, SETTINGS);
    if (content.stretch && !figure.querySelector('.stretch')) {
      const button = document.createElement('button'), whole = document.createElement('button');
      button.className = 'stretch';
      button.textContent = 'stretch with the most motion';
      whole.textContent = 'whole bag';
      button.onclick = () => Plotly.relayout(place, {'xaxis.range': content.stretch.slice()});
      whole.onclick = () => Plotly.relayout(place, {'xaxis.autorange': true});
      place.after(button, whole);
    }
  }
  const all = Array.from(document.querySelectorAll('figure.plot'));
  (function next(k) {
    if (k < all.length) { draw(all[k]); setTimeout(next, 0, k + 1); }
  })(0);
  let waiting = 0;
  addEventListener('resize', () => { clearTimeout(waiting); waiting = setTimeout(() => all.forEach(draw), 200); });
  addEventListener('beforeprint', () => {
    document.querySelectorAll('details').forEach(item => { item.open = true; });
    all.forEach(draw);
  });
  document.querySelectorAll('details').forEach(item => item.addEventListener('toggle',
    () => item.querySelectorAll('figure.plot').forEach(draw)));
})();
