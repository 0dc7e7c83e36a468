// Builds the viewer of published folders into dist/publish/viewer.js: one script that loads nothing but models.
import { defineConfig } from "vite";

export default defineConfig({
  publicDir: false,
  build: {
    target: "es2022",
    outDir: "dist/publish",
    chunkSizeWarningLimit: 900,
    modulePreload: { polyfill: false },
    reportCompressedSize: false,
    rollupOptions: {
      input: "src/published.ts",
      output: { entryFileNames: "viewer.js", inlineDynamicImports: true },
    },
  },
});
