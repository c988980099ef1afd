// Requests to the server. Every failure is an Error with the server's own sentence, its status and answer, and
// `offline` where the server cannot be reached at all.

const failure = (message, status, body) => Object.assign(new Error(message), { status, body, offline: status === 0 });

async function request(path, options = {}) {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw failure("The server does not answer", 0, null);
  }
  if (response.ok) return response;
  const body = await response.json().catch(() => ({}));
  throw failure(body.error ?? response.statusText, response.status, body);
}

const json = (path, options) => request(path, options).then((response) => response.json());
const clip = (name) => `/api/clips/${encodeURIComponent(name)}`;
const send = (body, { headers = {}, ...extra } = {}) => ({
  method: "POST",
  body: body instanceof Blob ? body : JSON.stringify(body),
  headers: { "content-type": "application/json", ...headers },
  ...extra,
});

export const getTrouble = (name, signal) => json(`${clip(name)}/trouble`, { signal }).then((answer) => answer.trouble);
export const getMoving = (name) => json(`${clip(name)}/moving`).then((answer) => answer.groups);
export const setWorkState = (name, state, by) =>
  json(`${clip(name)}/state`, send({ state, by }, { method: "PUT" })).then((answer) => answer.work);
export const listClips = () => json("/api/clips").then((answer) => answer.clips);
export const getClip = (name) => json(clip(name));
export const frameAddress = (name, frame) => `${clip(name)}/frames/${frame}`;
/** Post an annotation, or a file, to what the server makes of it: regions, labels, proposals/P, compare, import/F. */
export const post = (name, what, body, signal) => json(`${clip(name)}/${what}`, send(body, { signal }));
export const exportAs = (name, format, doc) =>
  request(`${clip(name)}/export/${format}`, send(doc)).then((response) => response.blob());
export const putAnnotation = (name, doc, revision) =>
  json(`${clip(name)}/annotation`, send(doc, { method: "PUT", headers: { "if-match": `"${revision}"` } }));

/** Trajectories as { xy: Float32Array, count, frames }, or { done, total } while they are computed. */
export async function getTracks(name) {
  const response = await request(`${clip(name)}/tracks`);
  if (response.status === 202) return response.json();
  const [count, frames] = response.headers.get("x-shape").split(",").map(Number);
  return { xy: new Float32Array(await response.arrayBuffer()), count, frames };
}
