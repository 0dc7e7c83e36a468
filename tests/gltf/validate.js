// Validates the .glb files that are its arguments; prints a report a file, fails if one has an error or a warning.
const fs = require('fs');
const validator = require('gltf-validator');

async function main(paths) {
  let bad = 0;
  for (const path of paths) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)), { uri: path });
    const { numErrors, numWarnings, messages } = report.issues;
    console.log(`${path}: ${numErrors} errors, ${numWarnings} warnings`);
    for (const m of messages) console.log(`  ${m.severity} ${m.code} ${m.pointer}: ${m.message}`);
    bad += numErrors + numWarnings;
  }
  process.exit(bad === 0 ? 0 : 1);
}

main(process.argv.slice(2)).catch((error) => { console.error(error); process.exit(2); });
