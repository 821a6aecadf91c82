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
