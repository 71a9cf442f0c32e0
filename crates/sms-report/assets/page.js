// Links the objects of the page: pictures, list, tables and the 3-D view highlight each other.
var SMS = (function () {
  'use strict';
  const listeners = [];
  let current = null;
  const highlight = (name) => {
    if (name === current) return;
    current = name;
    for (const element of document.querySelectorAll('[data-body]')) {
      element.classList.toggle('hot', element.dataset.body === name);
    }
    for (const listener of listeners) listener(name);
  };
  const follow = (event) => {
    const target = event.target;
    // The 3-D view finds the body under the pointer itself.
    if (!target.closest || target.closest('#viewer')) return;
    const element = target.closest('[data-body]');
    highlight(element ? element.dataset.body : null);
  };
  document.addEventListener('pointerover', follow);
  document.addEventListener('focusin', follow);
  document.addEventListener('focusout', () => highlight(null));

  // Pictures that appear twice are in the page once.
  for (const image of document.querySelectorAll('img[data-copy]')) {
    image.src = document.getElementById(image.dataset.copy).src;
  }
  return { highlight, onHighlight: (listener) => listeners.push(listener) };
})();
