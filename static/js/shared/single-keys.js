/** Whether single-letter shortcuts are on; with some input devices, letters are typed by accident. */

const OFF = "expmap.single-keys-off";

export const singleKeys = {
  get on() {
    return localStorage.getItem(OFF) === null;
  },
  set on(value) {
    if (value) localStorage.removeItem(OFF);
    else localStorage.setItem(OFF, "1");
  },
};
