// A word with its meaning: for who points at it, goes there with the keyboard, or touches it. Escape takes it away.
import { html, useEffect, useId, useLayoutEffect, useRef, useState } from '../html.js';
import { glossary, inTheBook } from '../glossary.js';

const BEFORE_MS = 200;
/** So that the pointer can go from the word to what it says. */
const AFTER_MS = 200;
const GAP = 4;

/** What the page calls otherwise than the glossary does, or only with units and numbers. */
const TERMS = {
  '95 % interval': 'interval',
  'asked for': 'limit',
  autocorrelation: 'autocorrelation',
  'best on train': 'train',
  'best on validation': 'validation',
  'between its bounds': 'bounds',
  'added up': 'pooled',
  'beyond the clock': 'beyond the clock',
  bias: 'bias',
  bic: 'BIC',
  bounds: 'bounds',
  'By circumstances, where the model fails most first': 'regime',
  check: 'check',
  correlation: 'correlation',
  cost: 'cost',
  deviation: 'deviation',
  effect: 'effect',
  'Effects by window': 'evidence',
  evaluations: 'evaluation',
  'evaluations in all': 'evaluation',
  'gain in BIC': 'gain in BIC',
  generation: 'generation',
  'holding the last value': 'persistence',
  'in the 95 % band': '95 % band',
  'Innovations: autocorrelation': 'autocorrelation',
  'Innovations: cumulated periodogram': 'periodogram',
  kept: 'kept',
  'lag, h': 'lag',
  'lag, samples': 'lag',
  'least cost': 'cost',
  lift: 'lift',
  'log-likelihood': 'log-likelihood',
  logarithmic: 'logarithmic',
  'mean absolute': 'mean absolute error',
  'model without it': 'null model',
  noise: 'sensor noise',
  nominal: 'nominal',
  'of the error': 'share of the error',
  'of the time': 'share of the time',
  'p of shifts': 'shift p',
  parameter: 'parameter',
  'Profile likelihoods': 'profile likelihood',
  'r²': 'r squared',
  revision: 'revision',
  rmse: 'RMSE',
  'rmse without bias': 'RMSE without bias',
  size: 'size',
  start: 'origin of a start',
  statistic: 'statistic',
  'stopped because': 'stopped because',
  t: 't value',
  test: 'test',
  'test (never used)': 'test',
  'test, never used': 'test',
  train: 'train',
  'train, free run': 'free run',
  'unusual then': 'unusual then',
  validation: 'validation',
  'validation, free run': 'validation',
  verdict: 'verdict',
  windows: 'window',
  'Worst six hours': 'episode',
};

const FAMILIES = [
  [/ against each channel, by lag$/, 'cross-correlation'],
  [/ ahead$/, 'hours ahead'],
  [/ unseen data$/, 'unseen data'],
  [/^Error ladder/, 'ladder'],
];

/** A text of the page as a term, where it is one as a whole. */
export function explained(text) {
  if (typeof text !== 'string') return text;
  const of = TERMS[text] ?? FAMILIES.find(([pattern]) => pattern.test(text))?.[1];
  return of ? html`<${Term} of=${of}>${text}</${Term}>` : text;
}

/** Takes away what is open: there is one at a time. */
let close = () => {};

/**
 * `of` is a heading of the glossary, `code` what the service calls it. Where a list repeats the same terms in every row,
 * `quiet` ones are no stops of the Tab key.
 */
export function Term({ of, code, quiet = false, class: kind = '', children }) {
  const [open, setOpen] = useState(false);
  const [meaning, setMeaning] = useState(null);
  const id = useId();
  const host = useRef(null);
  const tip = useRef(null);
  const timer = useRef(null);
  const pinned = useRef(false);
  const hide = () => {
    clearTimeout(timer.current);
    pinned.current = false;
    setOpen(false);
  };
  const show = () => {
    clearTimeout(timer.current);
    if (close !== hide) close();
    close = hide;
    setOpen(true);
  };
  useEffect(() => {
    let left = false;
    if (open) glossary().then(all => left || setMeaning(all.get(of) ?? ''));
    return () => {
      left = true;
    };
  }, [open, of]);
  useEffect(() => () => clearTimeout(timer.current), []);
  useLayoutEffect(() => {
    if (!tip.current) return undefined;
    // Above everything, and cut off by no table that scrolls.
    tip.current.showPopover?.();
    const place = () => {
      const word = host.current.getBoundingClientRect();
      const { width, height } = tip.current.getBoundingClientRect();
      const below = word.bottom + GAP;
      tip.current.style.left = `${Math.max(Math.min(word.left, innerWidth - width - 2 * GAP), 2 * GAP)}px`;
      tip.current.style.top = `${below + height > innerHeight ? Math.max(word.top - height - GAP, 0) : below}px`;
    };
    const onKey = event => {
      if (event.key !== 'Escape') return;
      event.preventDefault();
      hide();
    };
    const onPointer = event => host.current.contains(event.target) || hide();
    place();
    document.addEventListener('scroll', place, true);
    document.addEventListener('keydown', onKey, true);
    document.addEventListener('pointerdown', onPointer);
    return () => {
      document.removeEventListener('scroll', place, true);
      document.removeEventListener('keydown', onKey, true);
      document.removeEventListener('pointerdown', onPointer);
    };
  }, [open, meaning]);
  const enter = event => {
    clearTimeout(timer.current);
    if (event.pointerType === 'mouse') timer.current = setTimeout(show, BEFORE_MS);
  };
  const leave = () => {
    clearTimeout(timer.current);
    // What the keyboard or a click has opened stays.
    if (open && !pinned.current && !host.current.contains(document.activeElement)) timer.current = setTimeout(hide, AFTER_MS);
  };
  const focus = event => event.target.matches(':focus-visible') && show();
  const blur = event => host.current.contains(event.relatedTarget) || hide();
  const click = () => {
    if (open && pinned.current) return hide();
    show();
    pinned.current = true;
    return undefined;
  };
  const link = inTheBook(of);
  return html`<span class="term" ref=${host} onPointerEnter=${enter} onPointerLeave=${leave} onFocusIn=${focus} onFocusOut=${blur}><button
    type="button" class=${kind} tabindex=${quiet ? -1 : null} aria-describedby=${open ? id : null} onClick=${click}>${children}</button>${
    open && meaning && html`<span class="tip" role="tooltip" id=${id} popover="manual" ref=${tip}>${meaning}${
      code && html` <code>${code}</code>`}${link && html` <a href=${link}>Glossary</a>`}</span>`
  }</span>`;
}
