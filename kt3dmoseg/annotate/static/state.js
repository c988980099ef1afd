// The page's state: plain values and listeners.

export class State {
  #listeners = [];
  #changed = new Set();

  constructor(values) {
    Object.assign(this, values);
  }

  /** Call `listener(state)` in the next animation frame after any of `keys` changed: for drawing. */
  on(keys, listener) {
    this.#listeners.push({ keys, listener, now: false });
  }

  /** Call `listener(state)` at once when any of `keys` changes: for what must not wait for a picture. */
  now(keys, listener) {
    this.#listeners.push({ keys, listener, now: true });
  }

  /** Change values and wake the listeners. */
  set(changes) {
    const waiting = this.#changed.size > 0;
    const fresh = Object.keys(changes).filter((key) => this[key] !== changes[key]);
    Object.assign(this, changes);
    fresh.forEach((key) => this.#changed.add(key));
    if (!waiting && this.#changed.size) requestAnimationFrame(() => this.#draw());
    this.#call(fresh, true);
  }

  #draw() {
    const changed = [...this.#changed];
    this.#changed.clear();
    this.#call(changed, false);
  }

  #call(changed, now) {
    for (const entry of this.#listeners) {
      if (entry.now === now && entry.keys.some((key) => changed.includes(key))) entry.listener(this);
    }
  }
}
