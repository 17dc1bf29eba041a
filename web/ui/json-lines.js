// JSON with the places of its parts: a fault of the service names a pointer (`/equations/T_r`), a writer looks for a line.

/** A text that is no JSON, and where. */
class JsonFault extends Error {
  constructor(detail, line) {
    super(detail);
    this.line = line;
  }
}

const ESCAPES = { '"': '"', '\\': '\\', '/': '/', b: '\b', f: '\f', n: '\n', r: '\r', t: '\t' };

/** `{value, lines}`: the value, and for every pointer the line where its key, or its value in a list, begins. */
export function parse(text) {
  let at = 0;
  const lines = new Map([['', 1]]);
  const line = (place = at) => text.slice(0, place).split('\n').length;
  const fail = (detail, place = at) => {
    throw new JsonFault(detail, line(Math.min(place, text.length)));
  };
  const blank = () => {
    while (/\s/.test(text[at] ?? '')) at += 1;
  };
  const take = mark => {
    blank();
    if (text[at] !== mark) fail(`\`${mark}\` is expected here${at < text.length ? `, not \`${text[at]}\`` : ', not the end'}`);
    at += 1;
  };
  const string = () => {
    take('"');
    let read = '';
    while (text[at] !== '"') {
      if (at >= text.length || text[at] === '\n') fail('this text has no end: a `"` is missing');
      if (text[at] === '\\') {
        at += 1;
        if (text[at] === 'u') {
          read += String.fromCharCode(parseInt(text.slice(at + 1, at + 5), 16));
          at += 4;
        } else if (ESCAPES[text[at]] === undefined) fail(`\`\\${text[at]}\` means nothing`);
        else read += ESCAPES[text[at]];
      } else read += text[at];
      at += 1;
    }
    at += 1;
    return read;
  };
  const value = pointer => {
    blank();
    if (text[at] === '{') return object(pointer);
    if (text[at] === '[') return list(pointer);
    if (text[at] === '"') return string();
    const word = /^(true|false|null|-?\d+(\.\d+)?([eE][+-]?\d+)?)/.exec(text.slice(at))?.[0];
    if (!word) fail(at < text.length ? `\`${text[at]}\` is no value` : 'a value is missing');
    at += word.length;
    return JSON.parse(word);
  };
  const members = (close, one) => {
    at += 1;
    blank();
    if (text[at] === close) {
      at += 1;
      return;
    }
    for (;;) {
      one();
      // A comma is missing where the member ends, however many lines further what follows is.
      const end = at;
      blank();
      if (text[at] === close) {
        at += 1;
        return;
      }
      if (text[at] !== ',') fail(`a \`,\` or \`${close}\` is missing`, end);
      const comma = at;
      at += 1;
      blank();
      if (text[at] === close) fail(`nothing follows this \`,\``, comma);
    }
  };
  function object(pointer) {
    const found = {};
    members('}', () => {
      blank();
      const start = line();
      const key = string();
      const inner = `${pointer}/${key.replaceAll('~', '~0').replaceAll('/', '~1')}`;
      if (Object.hasOwn(found, key)) fail(`\`${key}\` is there twice`);
      lines.set(inner, start);
      take(':');
      found[key] = value(inner);
    });
    return found;
  }
  function list(pointer) {
    const found = [];
    members(']', () => {
      blank();
      const inner = `${pointer}/${found.length}`;
      lines.set(inner, line());
      found.push(value(inner));
    });
    return found;
  }
  const read = value('');
  blank();
  if (at < text.length) fail('something follows after the end of the document');
  return { value: read, lines };
}

/** The line of a pointer, or of the nearest part that is there. */
export function lineOf(lines, pointer) {
  let place = pointer;
  while (place && !lines.has(place)) place = place.slice(0, place.lastIndexOf('/'));
  return lines.get(place) ?? 1;
}
