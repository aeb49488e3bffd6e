// A job type for Flamenco 3 (https://flamenco.blender.org): copy it to the folder `scripts` beside the manager. It renders
// the frames of an animation, or, if `pieces` is more than 1, one image in as many pieces that a last task merges.

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
        { key: "fps", type: "float", default: 24, description: "Frames of a second of the animation" },
        { key: "chunk_size", type: "int32", default: 8, description: "Frames of a task; they share kernels" },
        { key: "spp", type: "int32", default: 64, description: "Samples per pixel" },
        {
            key: "pieces", type: "int32", default: 1,
            description: "Tasks of a single image, each with its share of the samples; then merged to an .exr",
        },
        { key: "flags", type: "string", default: "", description: "Further flags of penumbra render" },
        { key: "penumbra", type: "string", default: "penumbra", description: "The program on the workers" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    if (settings.frames && settings.pieces > 1) {
        throw "pieces are of a single image: leave frames empty, or let pieces be 1";
    }
    if (settings.pieces > settings.spp) {
        throw "there cannot be more pieces than samples";
    }
    if (settings.frames) {
        renderFrames(job, settings);
    } else if (settings.pieces > 1) {
        renderPieces(job, settings);
    } else {
        add(job, "render", [render(settings, settings.output, [])]);
    }
}

// A call of `penumbra render`.
function render(settings, output, flags) {
    const further = settings.flags.split(" ").filter((flag) => flag.length > 0);
    return call(settings, ["render", settings.scene, "-o", output, "--spp", String(settings.spp)].concat(flags, further));
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
    const files = [];
    const tasks = [];
    const first = (piece) => Math.floor((settings.spp * piece) / settings.pieces);
    for (let piece = 0; piece < settings.pieces; piece++) {
        const file = settings.output + "." + piece + ".exr";
        const samples = first(piece) + ".." + first(piece + 1);
        files.push(file);
        tasks.push(add(job, "samples " + samples, [render(settings, file, ["--samples", samples])]));
    }
    const merge = author.Task("merge", "misc");
    merge.addCommand(call(settings, ["merge"].concat(files, ["-o", settings.output])));
    tasks.forEach((task) => merge.addDependency(task));
    job.addTask(merge);
}
