// Requests to the server. Every failure is an Error with the server's own sentence, its status and answer, and
// `offline` where the server cannot be reached at all.

const failure = (message, status, body) => Object.assign(new Error(message), { status, body, offline: status === 0 });
const address = (clip, what) => ["/api/clips", encodeURIComponent(clip), what].filter(Boolean).join("/");
export const frameAddress = (clip, frame) => address(clip, `frames/${frame}`);

/** Ask for something of a clip; a body, an annotation or a file, is posted. */
export async function request(clip, what, body, { headers, ...options } = {}) {
  if (body) {
    options = { method: "POST", headers: { "content-type": "application/json", ...headers }, ...options };
    options.body = body instanceof Blob ? body : JSON.stringify(body);
  }
  const response = await fetch(address(clip, what), options).catch((error) => {
    throw error.name === "AbortError" ? error : failure("The server does not answer", 0, null);
  });
  if (response.ok) return response;
  const answer = await response.json().catch(() => ({}));
  throw failure(answer.error ?? response.statusText, response.status, answer);
}

export const ask = (...parts) => request(...parts).then((response) => response.json());
export const listClips = () => ask("").then(({ clips }) => clips);
