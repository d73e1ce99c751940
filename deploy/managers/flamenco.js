// A job type of Flamenco: one task submits a scene to a farm and waits for its bake, others are the farm's workers meanwhile.
// To the folder 'scripts' beside flamenco-manager. Flamenco's workers need 'kiln' on their path, and KILN_TOKEN with a
// token of the scopes 'submit' and 'worker'. The task that waits for the bake and those that work run at the same time, one
// to a worker of Flamenco: they need two of these. With one, the bake waits for a task that waits for its end.
"use strict";

const JOB_TYPE = {
    label: "Lightkiln Bake",
    settings: [
        { key: "scene", type: "string", subtype: "file_path", required: true, description: "A .glb, a .gltf with its files beside it, or a .zip of them" },
        { key: "server", type: "string", required: true, default: "http://farm:7410", description: "The farm's URL" },
        { key: "preset", type: "string", choices: ["draft", "medium", "high"], default: "medium", description: "Quality of the bake" },
        { key: "workers", type: "int32", default: 4, description: "Workers at a time" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const add = (name, ...args) => {
        const task = author.Task(name, "misc");
        task.addCommand(author.Command("exec", { exe: "kiln", args: args }));
        job.addTask(task);
    };
    add("bake", "submit", settings.scene, "--server", settings.server, "--preset", settings.preset, "--wait");
    for (let index = 1; index <= settings.workers; index++) {
        add(`worker ${index}`, "worker", "--server", settings.server, "--exit-when-idle", "300");
    }
}
