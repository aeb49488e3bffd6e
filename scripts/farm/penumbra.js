// A job type for Flamenco 3 (https://flamenco.blender.org): copy it to the folder `scripts` beside the manager. It renders
// the frames of an animation, or one image in pieces that a last task merges: ranges of its samples, tiles, or both.

const JOB_TYPE = {
    label: "Penumbra",
    description: "Render a glTF scene: the frames of its animation, or one image in pieces",
    settings: [
        { key: "scene", type: "string", subtype: "file_path", required: true, description: "The scene, .gltf or .glb" },
        {
            key: "output", type: "string", required: true,
            description: "The image, .exr or .png; {frame} in its name stands for the number of a frame",
        },
        { key: "frames", type: "string", default: "", description: "Frames, such as 0-99; empty for a single image" },
        { key: "fps", type: "float", default: 24, description: "Frames per second of the animation" },
        { key: "chunk_size", type: "int32", default: 8, description: "Frames per task; the frames of a task share kernels" },
        { key: "spp", type: "int32", default: 64, description: "Samples per pixel" },
        {
            key: "ranges", type: "int32", default: 1,
            description: "Ranges that the samples of a single image are cut into; a last task merges them",
        },
        { key: "columns", type: "int32", default: 1, description: "Columns of tiles that a single image is cut into" },
        {
            key: "rows", type: "int32", default: 1,
            description: "Rows of tiles; tiles need --width and --height among the flags",
        },
        { key: "flags", type: "string", default: "", description: "Further flags of penumbra render" },
        { key: "penumbra", type: "string", default: "penumbra", description: "The program on the workers" },
    ],
};

// Flags of `penumbra render` that decide how an image is shown and denoised, which `penumbra merge` has too.
const MERGING = ["--view", "--exposure", "--denoise", "--oidn", "--device"];

function compileJob(job) {
    const settings = job.settings;
    const pieces = settings.ranges * settings.columns * settings.rows;
    if (!(Math.min(settings.ranges, settings.columns, settings.rows) >= 1)) {
        throw "ranges, columns and rows must be at least 1";
    }
    if (settings.frames && pieces > 1) {
        throw "only a single image can be cut into pieces: leave frames empty, or set ranges, columns and rows to 1";
    }
    if (settings.ranges > settings.spp) {
        throw "there cannot be more ranges than samples";
    }
    if (settings.frames) {
        renderFrames(job, settings);
    } else if (pieces > 1) {
        renderPieces(job, settings);
    } else {
        add(job, "render", [render(settings, settings.output, [])]);
    }
}

// A call of `penumbra render`.
function render(settings, output, flags) {
    const own = ["render", settings.scene, "-o", output, "--spp", String(settings.spp)];
    return call(settings, own.concat(flags, further(settings)));
}

function further(settings) {
    return settings.flags.split(" ").filter((flag) => flag.length > 0);
}

function call(settings, args) {
    return author.Command("exec", { exe: settings.penumbra, args: args });
}

// Adds a task of some calls to the job.
function add(job, name, calls) {
    const task = author.Task(name, "misc");
    calls.forEach((call) => task.addCommand(call));
    job.addTask(task);
    return task;
}

function renderFrames(job, settings) {
    if (!settings.output.includes("{frame}")) {
        throw "the name of the output must contain {frame}";
    }
    for (let chunk of frameChunker(settings.frames, settings.chunk_size)) {
        // A chunk is a range or a list of frames and ranges: "0-7" or "0,2,5-6".
        const calls = chunk.split(",").map((part) => {
            const ends = part.split("-");
            const range = ends[0] + ".." + ends[ends.length - 1];
            return render(settings, settings.output, ["--frames", range, "--fps", String(settings.fps)]);
        });
        add(job, "frames " + chunk, calls);
    }
}

function renderPieces(job, settings) {
    const crops = tiles(settings);
    // A .png is denoised by default, for which the pieces must keep what denoisers need.
    const isDenoised = /\.png$/i.test(settings.output) && given(settings, "--denoise") === undefined;
    const guides = isDenoised ? ["--denoise", "auto"] : [];
    const files = [];
    const tasks = [];
    for (let samples of spans(settings.spp, settings.ranges)) {
        for (let crop of crops) {
            const file = settings.output + "." + files.length + ".exr";
            const range = samples[0] + ".." + samples[1];
            const cut = ["--samples", range].concat(crop ? ["--crop", crop] : [], guides);
            const name = "samples " + range + (crop ? " of " + crop : "");
            files.push(file);
            tasks.push(add(job, name, [render(settings, file, cut)]));
        }
    }
    const merge = author.Task("merge", "misc");
    const flags = MERGING.filter((name) => given(settings, name) !== undefined);
    const words = flags.map((name) => name + "=" + given(settings, name));
    merge.addCommand(call(settings, ["merge"].concat(files, ["-o", settings.output], words)));
    tasks.forEach((task) => merge.addDependency(task));
    job.addTask(merge);
}

// The tiles of the image, as values of --crop; a null stands for all of it.
function tiles(settings) {
    if (further(settings).some((flag) => /^--(crop|samples)(=|$)/.test(flag))) {
        throw "ranges, columns and rows cut the image: --crop and --samples cannot be among the flags";
    }
    if (settings.columns * settings.rows === 1) {
        return [null];
    }
    const width = Number(given(settings, "--width"));
    const height = Number(given(settings, "--height"));
    if (!(settings.columns <= width && settings.rows <= height)) {
        throw "tiles need --width and --height among the flags, and at least one pixel each";
    }
    const crops = [];
    for (let y of spans(height, settings.rows)) {
        for (let x of spans(width, settings.columns)) {
            crops.push([x[0], y[0], x[1] - x[0], y[1] - y[0]].join(","));
        }
    }
    return crops;
}

// The value that a flag has, in one word or in two; undefined if it is not there.
function given(settings, name) {
    const flags = further(settings);
    for (let i = 0; i < flags.length; i++) {
        if (flags[i] === name) {
            return flags[i + 1];
        }
        if (flags[i].startsWith(name + "=")) {
            return flags[i].slice(name.length + 1);
        }
    }
}

// A length in equal parts: where each begins and ends.
function spans(length, parts) {
    const edge = (part) => Math.floor((length * part) / parts);
    return Array.from({ length: parts }, (_, part) => [edge(part), edge(part + 1)]);
}
