/** Limit how often a function runs. */

/**
 * Call a function at most once a frame.
 * @param {function(): void} run
 * @returns {function(): void}
 */
export function rafThrottle(run) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      run();
    });
  };
}

/**
 * Call a function at most once a frame, after the frame is painted: for what may be seen a moment later than the
 * answer to a click.
 * @param {function(): void} run
 * @returns {function(): void}
 */
export function afterPaint(run) {
  return rafThrottle(() => setTimeout(run));
}

/**
 * Call a function when its calls have paused.
 * @param {function(...*): void} run
 * @param {number} milliseconds
 */
export function debounce(run, milliseconds) {
  let timer = 0;
  return (...args) => {
    clearTimeout(timer);
    timer = setTimeout(() => run(...args), milliseconds);
  };
}
