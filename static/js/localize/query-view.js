/** The query photo, and the menu of actions on its answer. */

import { copy } from "../shared/clipboard.js";
import { confirmDialog } from "../shared/dialogs.js";
import { byId } from "../shared/dom.js";
import { moment, t, tn } from "../shared/i18n.js";
import { PanoramaView } from "../shared/panorama-view.js";
import { PhotoZoom } from "../shared/photo-zoom.js";
import { shareAnswer } from "../shared/share-dialog.js";
import { toastError } from "../shared/toast.js";

/**
 * @param {{session: import("../shared/answer/query-session.js").QuerySession, server: Object, slug: string}} page
 * @param {{forgotten: function(): void}} on
 */
export function showQuery({ session, server, slug }, on) {
  const [box, image, frame] = [byId("query"), byId("query-image", HTMLImageElement), byId("query-frame")];
  const zoom = new PhotoZoom(frame, image);
  const around = new PanoramaView(image);
  session.on("query live answer chosen", () => {
    const { query, answer, hypothesis, live } = session;
    const isPanorama = !live && query?.id && answer?.fov_deg === 360;
    around.show(isPanorama ? { name: query.name, src: query.preview, heading: hypothesis?.heading_deg ?? null } : null);
  });
  image.addEventListener("error", () => frame.classList.add("is-broken"));
  image.addEventListener("load", () => frame.classList.remove("is-broken"));
  session.on("query live", () => {
    const { query, live } = session;
    const empty = !query && !live;
    box.hidden = empty;
    byId("welcome").hidden = !empty;
    byId("video").hidden = !live;
    image.hidden = live;
    byId("query-menu", HTMLDetailsElement).hidden = !query?.id;
    byId("query-name").textContent = live ? t("Live camera") : query?.name || "";
    byId("query-about").textContent = live || !query ? "" : about(query);
    if (!query || live) return;
    const source = query.preview || query.url;
    if (image.getAttribute("src") !== source) {
      frame.classList.remove("is-broken");
      image.src = source;
      zoom.reset();
    }
    image.alt = query.name;
    if (query.id) byId("query-download", HTMLAnchorElement).href = query.photo;
  });
  byId("query-link").addEventListener("click", () => copy(location.href, t("The link has been copied.")));
  document.getElementById("query-share")?.addEventListener("click", () => {
    byId("query-menu", HTMLDetailsElement).open = false;
    shareAnswer({ slug, query: session.query.id });
  });
  byId("query-delete").addEventListener("click", async () => {
    byId("query-menu", HTMLDetailsElement).open = false;
    const { id, name } = session.query;
    const sure = await confirmDialog({ title: t("Delete {name} and its answer?", { name }), action: t("Delete"), danger: true });
    if (!sure) return;
    try {
      await server.forget(id);
      session.setAnswer(null);
      session.setQuery(null);
      history.replaceState(null, "", location.pathname);
      on.forgotten();
    } catch (error) {
      toastError(error);
    }
  });
}

function about({ at, who, options }) {
  if (!at) return "";
  const several = options.photos > 1 && tn("{n} photo from one spot", "{n} photos from one spot", options.photos);
  return [several, who, moment(at)].filter(Boolean).join(" · ");
}
