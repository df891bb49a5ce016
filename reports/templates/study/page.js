"use strict";
// The page works without this script: it adds keys, counts what was watched, and says what is missing before the server does.
(() => {
  const form = document.getElementById("form");
  const video = document.getElementById("video");
  const next = document.getElementById("next");
  const status = document.getElementById("wait");
  const questions = [...form.querySelectorAll("fieldset")];
  let left = Number(form.dataset.wait);
  let sent = false;
  form.noValidate = true;

  const answered = (question) => {
    const text = question.querySelector('input[type="text"]');
    return text ? text.value.trim() !== "" : question.querySelector("input:checked") !== null;
  };
  const missing = () => questions.find((question) => !answered(question));
  const focused = () => questions.find((question) => question.contains(document.activeElement));
  const current = () => focused() || missing();

  const mark = () => {
    if (!missing()) show();
    const due = current();
    for (const question of questions) question.classList.toggle("current", question === due);
  };
  const enter = (question) => {
    const field = question.querySelector("input:checked") || question.querySelector("input");
    field.focus();
  };

  const say = (text, urgent = false) => {
    if (status.textContent !== text) status.textContent = text;
    status.classList.toggle("problem", urgent);
  };
  const show = () => {
    next.disabled = left > 0 || sent;
    if (left > 0 && video.paused && video.readyState >= 2) say("Press play: the video is to be watched once.");
    else if (left > 0) say(`You can go on in ${Math.ceil(left)} s.`);
    else say("");
  };

  // Only time in which the video runs counts; it may have begun before this script did.
  let before = null;
  const tick = (now) => {
    if (before !== null && !video.paused && !video.ended && video.readyState >= 2) left -= Math.min(now - before, 1000) / 1000;
    before = now;
    show();
    if (left > 0) setTimeout(() => tick(performance.now()), 200);
  };
  tick(performance.now());

  const trouble = () => {
    document.getElementById("trouble").hidden = false;
  };
  video.addEventListener("error", trouble);
  if (video.error) trouble();
  const playing = video.play();
  if (playing) playing.catch(show);

  form.addEventListener("submit", (event) => {
    const gap = missing();
    if (left > 0 || sent || gap) {
      event.preventDefault();
      if (gap) {
        enter(gap);
        say("An answer is missing.", true);
      }
      return;
    }
    sent = true;
    show();
  });
  window.addEventListener("pageshow", () => {
    sent = false;
    show();
  });

  document.addEventListener("focusin", mark);
  form.addEventListener("change", mark);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const typing = event.target.matches('input[type="text"]');
    if (event.key === "Enter" && (typing || !event.target.matches("a, button, video, summary"))) {
      event.preventDefault();
      form.requestSubmit();
    } else if (!typing && /^[1-9]$/.test(event.key)) {
      const question = current() || questions[questions.length - 1];
      const choice = question.querySelectorAll('input[type="radio"]')[Number(event.key) - 1];
      if (!choice) return;
      event.preventDefault();
      choice.checked = true;
      choice.dispatchEvent(new Event("change", { bubbles: true }));
      const gap = missing();
      enter(gap || question);
      mark();
    }
  });
  mark();
})();
