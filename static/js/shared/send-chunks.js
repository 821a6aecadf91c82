/** Uploads a file in chunks, resuming where it stopped whenever the connection breaks. */

const RETRY_MS = [1000, 2000, 4000, 8000, 15000];
const MOST_REFUSALS = 5;

/**
 * @typedef {Object} Way how a file is sent
 * @property {function(): Promise<{id: string, offset: number, chunk_bytes: number}>} begin begins or resumes an upload
 * @property {function(string, Blob, Object): Promise<Object>} sendChunk
 * @property {function(number): void} onProgress called with the number of bytes sent
 * @property {AbortSignal} signal
 */

/**
 * Send a file.
 * @param {File} file
 * @param {Way} way
 * @returns {Promise<Object>} response of the server to the last chunk
 */
export async function sendInChunks(file, way) {
  let sent = 0;
  const onProgress = (bytes) => {
    sent = bytes;
    way.onProgress(bytes);
  };
  for (let failures = 0; ; failures += 1) {
    const before = sent;
    try {
      return await sendRest(file, { ...way, onProgress });
    } catch (error) {
      const { status } = error;
      const passing = status === 0 || status === 409 || status === 429 || (status >= 500 && status !== 507);
      if (!passing || (status !== 0 && failures >= MOST_REFUSALS)) throw error;
      if (sent > before) failures = 0;
      await pause(RETRY_MS[Math.min(failures, RETRY_MS.length - 1)], way.signal);
    }
  }
}

async function sendRest(file, { begin, sendChunk, onProgress, signal }) {
  const begun = await begin();
  let { offset } = begun;
  for (;;) {
    signal.throwIfAborted();
    const chunk = file.slice(offset, offset + begun.chunk_bytes);
    const first = offset;
    const answer = await sendChunk(begun.id, chunk, {
      headers: { "Upload-Offset": String(offset), "Content-Type": "application/octet-stream" },
      signal,
      onProgress: (bytes) => onProgress(Math.min(first + bytes, file.size)),
    });
    if (answer.error) throw Object.assign(new Error(answer.error.message), { status: 422, ...answer.error });
    offset = answer.offset;
    if (offset >= file.size) return answer;
  }
}

function pause(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(signal.reason);
    }, { once: true });
  });
}
