// The one place that names the libraries.
import { h, render, Fragment } from './vendor/preact.mjs';
import htm from './vendor/htm.mjs';

export { useState, useEffect, useLayoutEffect, useMemo, useRef, useCallback, useId, useErrorBoundary } from './vendor/hooks.mjs';
export { h, render, Fragment };
export const html = htm.bind(h);
