/** The parts of a page that modules read when loaded: texts, colours, events, and Leaflet's positions. */

const scale = Array.from({ length: 101 }, (_, percent) => `fill ${percent}`);
const data = {
  i18n: { language: "en", plurals: ["one", "other"], messages: { Hello: "Ahoj", "{n} photo": ["{n} fotka", "{n} fotek"] } },
  accepted: { sidecars: ".json,.xmp", positions: ".cfg,.gpx,text/plain" },
  written: [{ name: "note", kind: "note", label: "Note", most: 4000, lines: true }, { name: "sky", kind: "sky", label: "Sky", most: 60, lines: false }],
  colours: { scale, text: scale.map((name) => name.replace("fill", "text")) },
};

globalThis.document = {
  getElementById: (id) => (id in data ? { textContent: JSON.stringify(data[id]) } : null),
  querySelector: () => null,
};
globalThis.addEventListener = () => {};
globalThis.L = /** @type {*} */ ({ CRS: {}, ImageOverlay: class {}, Layer: class {}, TileLayer: class {}, latLng: (lat, lng) => ({ lat, lng }) });
globalThis.matchMedia = () => ({ matches: false });
