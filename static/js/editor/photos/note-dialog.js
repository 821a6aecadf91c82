/** The dialog for notes and tags of several photos. */

import { errorLine, field, openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { countTags, retagged, tagsOf } from "./tags.js";

const MOST = 4000; // characters of a note

/**
 * Ask for text to add to the notes, and for tags to add or remove.
 * @param {import("../commands.js").Commands} commands
 * @param {number[]} ids
 */
export function noteDialog(commands, ids) {
  const { store } = commands;
  if (!ids.every((id) => store.isKnown(id))) {
    commands.warn(t("The notes of these photos are still being loaded."), t("Try again in a moment."));
    return;
  }
  const photos = ids.map((id) => store.photos.get(id));
  const here = countTags(photos);
  const ticks = new Map([...countTags([...store.photos.values()]).keys()].map((tag) => [tag, tick(here.get(tag) ?? 0, photos.length)]));
  const words = h("textarea", { class: "input note-input", rows: 2, maxlength: MOST, "data-testid": "notes-add" });
  const tags = h("input", { class: "input", autocomplete: "off", maxlength: 200, placeholder: t("gate, north"), "data-testid": "tags-add" });
  const error = errorLine();
  const save = h("button", { class: "button button--primary", type: "button" }, t("Save"));
  const known = ticks.size > 0 && h("fieldset", { class: "tag-list small" }, h("legend", {}, t("Tags")), ...[...ticks].map(([tag, input]) => h("label", { class: "check" }, input, `#${tag}`)));
  const dialog = openDialog(tn("Note and tags of {n} photo", "Notes and tags of {n} photos", ids.length), [
    field(t("Add to each note"), words),
    known,
    field(t("New tags"), tags),
    h("p", { class: "soft small" }, t("Tags are the words of a note that begin with #. Filter and search find them.")),
    error,
  ].filter(Boolean), { actions: [save] });
  save.addEventListener("click", () => {
    const changes = {
      add: [...[...ticks].filter(([, { checked }]) => checked).map(([tag]) => tag), ...tagsOf(asTags(tags.value))],
      remove: [...ticks].filter(([tag, { checked, indeterminate }]) => here.has(tag) && !checked && !indeterminate).map(([tag]) => tag),
    };
    const now = ids.map((id) => store.photos.get(id)).filter(Boolean); // others may have changed the notes meanwhile
    const notes = new Map(now.map(({ id, note }) => [id, retagged(withWords(note, words.value.trim()), changes)]));
    const long = now.find(({ id }) => notes.get(id).length > MOST);
    if (long) {
      error.show({ message: t("The note of {name} would be longer than {n} characters.", { name: long.name, n: MOST }) });
      return;
    }
    commands.noteAll(notes);
    dialog.close();
  });
}

/** A checkbox: checked if all photos have the tag, indeterminate (no change) if only some have it. */
function tick(count, all) {
  const input = h("input", { type: "checkbox" });
  input.checked = count === all;
  input.indeterminate = count > 0 && count < all;
  return input;
}

/** Parse new tags: words with or without #, separated by spaces or commas. @param {string} text */
function asTags(text) {
  return text.split(/[\s,;]+/).filter(Boolean).map((word) => `#${word.replace(/^#+/, "")}`).join(" ");
}

/** A note with a line appended. @param {?string} note @param {string} words */
function withWords(note, words) {
  return [note, words].filter(Boolean).join("\n");
}
