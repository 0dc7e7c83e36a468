// Builds the page into dist, from where the program's build takes it. Nothing is loaded from elsewhere, and nothing is
// put into the page itself, for its policy allows no script and no style there.
import { defineConfig } from "vite";

export default defineConfig({
  build: {
    target: "es2022",
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 900,
    modulePreload: { polyfill: false },
    reportCompressedSize: false,
  },
});
