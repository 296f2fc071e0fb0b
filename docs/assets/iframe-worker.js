// Search in pages opened from a disk: browsers start no worker for file:// addresses, so a hidden frame does its work.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.documentElement.append(frame);
      this.inside = frame.contentWindow;
      window.addEventListener("message", (event) => {
        if (event.source !== this.inside) return;
        const arrived = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(arrived);
        if (this.onmessage) this.onmessage(arrived);
      });
      // `importScripts` of a worker waits for each file; here a promise does.
      const importScripts = `(...files) => files.reduce((before, file) => before.then(() => new Promise((done, failed) => {
        const script = document.createElement("script");
        script.src = file;
        script.onload = done;
        script.onerror = failed;
        document.head.append(script);
      })), Promise.resolve())`;
      const page = frame.contentDocument;
      page.open();
      page.write(
        `<html><head></head><body><script>self.postMessage = (data) => parent.postMessage(data, "*");` +
        `self.importScripts = ${importScripts}</` + `script><script src="${url}"></` + `script></body></html>`
      );
      page.close();
      this.ready = new Promise((done) => frame.addEventListener("load", done, { once: true }));
    }

    postMessage(data) {
      // Not `postMessage`: inside, it is the one that answers.
      this.ready.then(() => this.inside.dispatchEvent(new this.inside.MessageEvent("message", { data })));
    }

    terminate() {}
  };
}
