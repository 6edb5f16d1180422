/* Search from the disk: a page of file: has no workers, so the worker of the search runs in a hidden frame. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = [];
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = "<!doctype html>";
      frame.onload = () => {
        const inner = frame.contentWindow;
        inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        const script = inner.document.createElement("script");
        script.src = url;
        script.onload = () => {
          this.send = (data) => inner.dispatchEvent(new MessageEvent("message", { data }));
          this.waiting.splice(0).forEach(this.send);
        };
        inner.document.body.append(script);
      };
      this.send = (data) => this.waiting.push(data);
      (document.body || document.documentElement).append(frame);
    }

    postMessage(data) {
      this.send(data);
    }
  };
}
