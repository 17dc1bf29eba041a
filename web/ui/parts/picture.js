// A chart as a picture: title, legends and lines, at the places where the screen shows them.
import { colour } from '../theme.js';

const SCALE = 2;
const MARGIN = 12;
const TEXTS = 'h3, .legend, .told, :scope > .note';
/** What the style sheet says of an SVG; a picture has no style sheet. */
const LOOKS = [
  'fill', 'stroke', 'stroke-width', 'stroke-dasharray', 'stroke-linejoin', 'opacity', 'text-anchor', 'dominant-baseline', 'font-family',
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

/** The PNG of a figure, at twice the size of the screen. */
export async function picture(figure) {
  const { left, top, width } = figure.getBoundingClientRect();
  const canvases = [...figure.querySelectorAll('.plot canvas')];
  const svgs = [...figure.querySelectorAll('svg')].filter(svg => !svg.closest('table'));
  const texts = [...wordsOf(figure)];
  const boxes = [...[...canvases, ...svgs].map(part => part.getBoundingClientRect()), ...texts.map(({ box }) => box)];
  const canvas = document.createElement('canvas');
  canvas.width = Math.ceil(width * SCALE);
  canvas.height = Math.ceil((Math.max(...boxes.map(box => box.bottom)) - top + MARGIN) * SCALE);
  const ctx = canvas.getContext('2d');
  ctx.fillStyle = colour('ground');
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.setTransform(SCALE, 0, 0, SCALE, -left * SCALE, -top * SCALE);
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
