// Writes the files of this folder with the official encoders, from npm:
//     npm install sharp ktx2-encoder@0.6.0 draco3dgltf@1.5.7 gltfpack \
//         @gltf-transform/core@4 @gltf-transform/extensions@4 @gltf-transform/functions@4
//     node make.mjs
//     npx gltfpack -i sheet.glb -o sheet-meshopt-ext.glb -c
//     npx gltfpack -i sheet.glb -o sheet-meshopt-khr.glb -cz -vpf
import { readFileSync, writeFileSync } from "node:fs";
import { Document, NodeIO } from "@gltf-transform/core";
import { KHRDracoMeshCompression } from "@gltf-transform/extensions";
import { draco } from "@gltf-transform/functions";
import draco3d from "draco3dgltf";
import { encodeToKTX2 } from "ktx2-encoder";
import sharp from "sharp";

// The texels that tests/scene/compressed.rs expects.
const [width, height] = [22, 18];
const data = new Uint8Array(width * height * 4);
for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
        data.set([11 * x, 13 * y, 6 * (x + y), 255 - 5 * x], 4 * (y * width + x));
    }
}
const image = async () => ({ data, width, height });
const both = { imageDecoder: image, generateMipmap: true, isKTX2File: true };
const ktx2 = async (name, options) => writeFileSync(name, await encodeToKTX2(data, { ...both, ...options }));
await ktx2("etc1s.ktx2", { isUASTC: false, qualityLevel: 255, compressionLevel: 5 });
await ktx2("uastc.ktx2", { isUASTC: true, needSupercompression: false });
await ktx2("uastc-zstd.ktx2", { isUASTC: true, needSupercompression: true });
// What the official transcoder makes of them.
const folder = "./node_modules/ktx2-encoder/dist/basis/";
const { default: basis } = await import(`${folder}basis_encoder.js`);
const module = await basis({ wasmBinary: readFileSync(`${folder}basis_encoder.wasm`) });
module.initializeBasis();
for (const name of ["etc1s", "uastc"]) {
    const file = new module.KTX2File(new Uint8Array(readFileSync(`${name}.ktx2`)));
    file.startTranscoding();
    const [level, layer, face, rgba32] = [0, 0, 0, 13];
    const texels = new Uint8Array(file.getImageTranscodedSizeInBytes(level, layer, face, rgba32));
    file.transcodeImage(texels, level, layer, face, rgba32, 0, -1, -1);
    writeFileSync(`${name}.rgba`, texels);
}

const raw = { raw: { width, height, channels: 4 } };
writeFileSync("lossy.webp", await sharp(data, raw).webp({ quality: 90 }).toBuffer());

// A sheet of 12 x 12 vertices, as it is and compressed by each of the two methods.
const sheet = () => {
    const document = new Document();
    const buffer = document.createBuffer();
    const side = 12;
    const [positions, normals, uvs, indices] = [[], [], [], []];
    for (let i = 0; i < side * side; i++) {
        const [x, y] = [i % side, Math.floor(i / side)];
        positions.push(x, Math.sin(x * 0.5) * Math.cos(y * 0.4), y);
        const normal = [0.1 * Math.sin(x), 1, 0.1 * Math.cos(y)];
        const length = Math.hypot(...normal);
        normals.push(...normal.map((n) => n / length));
        uvs.push(x / (side - 1), y / (side - 1));
        if (x + 1 < side && y + 1 < side) {
            indices.push(i, i + side, i + 1, i + 1, i + side, i + side + 1);
        }
    }
    const accessor = (type, array) => document.createAccessor().setType(type).setArray(array).setBuffer(buffer);
    const primitive = document
        .createPrimitive()
        .setIndices(accessor("SCALAR", new Uint16Array(indices)))
        .setAttribute("POSITION", accessor("VEC3", new Float32Array(positions)))
        .setAttribute("NORMAL", accessor("VEC3", new Float32Array(normals)))
        .setAttribute("TEXCOORD_0", accessor("VEC2", new Float32Array(uvs)));
    const mesh = document.createMesh().addPrimitive(primitive);
    document.createScene().addChild(document.createNode().setMesh(mesh));
    return document;
};
const io = new NodeIO().registerExtensions([KHRDracoMeshCompression]).registerDependencies({
    "draco3d.encoder": await draco3d.createEncoderModule(),
    "draco3d.decoder": await draco3d.createDecoderModule(),
});
await io.write("sheet.glb", sheet());
// Without quantization, so that no bit is lost.
const exact = sheet();
exact
    .createExtension(KHRDracoMeshCompression)
    .setRequired(true)
    .setEncoderOptions({ method: KHRDracoMeshCompression.EncoderMethod.SEQUENTIAL, quantizationBits: { POSITION: 0, NORMAL: 0, TEX_COORD: 0 } });
await io.write("sheet-exact.glb", exact);
for (const method of ["edgebreaker", "sequential"]) {
    const document = sheet();
    await document.transform(draco({ method, quantizePosition: 14, quantizeNormal: 10, quantizeTexcoord: 12 }));
    await io.write(`sheet-${method}.glb`, document);
}
