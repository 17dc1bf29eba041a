// A chart as a picture: what it is about, then title, legends and lines, at the places where the screen shows them.
import { colour } from '../theme.js';

const SCALE = 2;
const MARGIN = 12;
const ABOUT_PX = 12;
const LINE_PX = 17;
const TEXTS = 'h3, .legend, .told, :scope > .note, .small-multiples p, .small-multiples div > b, .small-multiples div > small';
/** What the style sheet says of an SVG; a picture has no style sheet. */
const LOOKS = [
  'fill', 'stop-color', 'stroke', 'stroke-width', 'stroke-dasharray', 'stroke-linejoin', 'opacity', 'text-anchor', 'dominant-baseline', 'font-family',
  'font-size', 'font-weight',
];

async function imageOf(svg) {
  const copy = svg.cloneNode(true);
  const parts = [svg, ...svg.querySelectorAll('*')];
  [copy, ...copy.querySelectorAll('*')].forEach((part, at) => {
    const look = getComputedStyle(parts[at]);
    for (const name of LOOKS) part.style.setProperty(name, look.getPropertyValue(name));
  });
  const { width, height } = svg.getBoundingClientRect();
  copy.setAttribute('width', width);
  copy.setAttribute('height', height);
  const image = new Image();
  image.src = `data:image/svg+xml,${encodeURIComponent(new XMLSerializer().serializeToString(copy))}`;
  await image.decode();
  return image;
}

/** Every word of the texts with its place: a text may be broken into lines. */
function* wordsOf(figure) {
  for (const text of figure.querySelectorAll(TEXTS)) {
    const walker = document.createTreeWalker(text, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const node = walker.currentNode;
      for (const { 0: word, index } of node.data.matchAll(/\S+/g)) {
        const range = document.createRange();
        range.setStart(node, index);
        range.setEnd(node, index + word.length);
        yield { word, box: range.getBoundingClientRect(), look: getComputedStyle(node.parentElement) };
      }
    }
  }
}

/** A text in lines that fit into a width. */
function linesOf(ctx, text, width) {
  const lines = [''];
  for (const word of text.split(' ')) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (lines.at(-1) && ctx.measureText(longer).width > width) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  return lines;
}

/** The PNG of a figure, at twice the size of the screen. Above it stands whose it is, as the page says, and what it is `about`. */
export async function picture(figure, about) {
  const { left, top, width } = figure.getBoundingClientRect();
  const canvases = [...figure.querySelectorAll('.plot canvas')];
  const svgs = [...figure.querySelectorAll('svg')].filter(svg => !svg.closest('table'));
  const texts = [...wordsOf(figure)];
  const boxes = [...[...canvases, ...svgs].map(part => part.getBoundingClientRect()), ...texts.map(({ box }) => box)];
  const canvas = document.createElement('canvas');
  const ctx = canvas.getContext('2d');
  const letters = `${ABOUT_PX}px ${getComputedStyle(figure).fontFamily}`;
  ctx.font = letters;
  const of = figure.closest('[data-about]')?.dataset.about ?? document.querySelector('h1')?.textContent;
  const lines = linesOf(ctx, [of, about].filter(Boolean).join(' · '), width - 2 * MARGIN);
  const head = MARGIN / 2 + lines.length * LINE_PX;
  canvas.width = Math.ceil(width * SCALE);
  canvas.height = Math.ceil((head + Math.max(...boxes.map(box => box.bottom)) - top + MARGIN) * SCALE);
  ctx.fillStyle = colour('ground');
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.scale(SCALE, SCALE);
  ctx.font = letters;
  ctx.fillStyle = colour('text');
  lines.forEach((line, at) => ctx.fillText(line, MARGIN, MARGIN / 2 + (at + 0.8) * LINE_PX));
  ctx.translate(-left, head - top);
  const put = (image, box) => box.width > 0 && box.height > 0 && ctx.drawImage(image, box.left, box.top, box.width, box.height);
  const images = await Promise.all(svgs.map(imageOf));
  canvases.forEach(part => put(part, part.getBoundingClientRect()));
  images.forEach((image, at) => put(image, svgs[at].getBoundingClientRect()));
  ctx.textBaseline = 'middle';
  for (const { word, box, look } of texts) {
    ctx.font = `${look.fontWeight} ${look.fontSize} ${look.fontFamily}`;
    ctx.fillStyle = look.color;
    ctx.fillText(word, box.left, (box.top + box.bottom) / 2);
  }
  return new Promise(done => canvas.toBlob(done, 'image/png'));
}
