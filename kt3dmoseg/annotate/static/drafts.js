// Edits that the server does not have yet, kept in this browser so that closing it loses nothing.
// Each tab has its own draft; a tab holds a lock while it lives, so that others leave its draft alone.

const tab = (sessionStorage.tab ??= crypto.randomUUID());
const keyOf = (clip, owner) => `draft:${clip}:${owner}`;

navigator.locks?.request(`tab:${tab}`, { ifAvailable: true }, () => new Promise(() => {}));

export function keep(clip, base, doc) {
  try {
    localStorage.setItem(keyOf(clip, tab), JSON.stringify({ base, doc }));
    return true;
  } catch {
    return false;
  }
}

export function drop(clip) {
  localStorage.removeItem(keyOf(clip, tab));
}

/** Drafts of this clip by this tab, and by tabs that are gone; they are handed over once. */
export async function recover(clip) {
  const held = (await navigator.locks?.query())?.held?.map((lock) => lock.name) ?? [];
  const found = [];
  for (const key of Object.keys(localStorage)) {
    const owner = key.startsWith(`draft:${clip}:`) ? key.slice(`draft:${clip}:`.length) : null;
    if (owner && (owner === tab || !held.includes(`tab:${owner}`))) {
      found.push(JSON.parse(localStorage.getItem(key)));
      localStorage.removeItem(key);
    }
  }
  return found;
}
