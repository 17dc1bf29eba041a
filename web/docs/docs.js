// Shows the description of the surface. It comes from this service alone; every text enters the page as text.

const METHODS = ["get", "post", "put", "patch", "delete"];
const THEMES = ["system", "light", "dark"];
const $ = (id) => document.getElementById(id);

/** An element with attributes and children; a text may hold `code`. */
function el(name, attributes = {}, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
        if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
        else if (value !== undefined && value !== false) node.setAttribute(key, value === true ? "" : value);
    }
    node.append(...children.flat().filter((child) => child !== undefined && child !== null && child !== ""));
    return node;
}

/** A sentence in which `this` is code. */
const prose = (text = "") => text.split("`").map((part, index) => (index % 2 ? el("code", {}, part) : part));

let description;

function resolved(thing) {
    const path = thing?.$ref?.split("/").slice(1);
    return path ? path.reduce((node, key) => node?.[key], description) : thing;
}

/** The parts of a schema that can stand for it: what is behind references, `allOf` and a `oneOf` with null. */
function flat(schema) {
    const name = schema?.$ref?.split("/").pop();
    const found = { ...resolved(schema) };
    const choices = (found.oneOf ?? found.anyOf ?? []).filter((one) => one.type !== "null");
    if (choices.length === 1) {
        const inner = flat(choices[0]);
        return { ...inner, optional: true, description: found.description ?? inner.description };
    }
    for (const part of found.allOf ?? []) {
        const inner = flat(part);
        found.properties = { ...inner.properties, ...found.properties };
        found.required = [...(inner.required ?? []), ...(found.required ?? [])];
        found.type ??= inner.type;
    }
    return { ...found, name, choices };
}

function typeName(schema) {
    const one = flat(schema);
    const types = [one.type ?? (one.properties ? "object" : "anything")].flat().filter((type) => type !== "null");
    const item = one.items && one.items !== true ? ` of ${typeName(one.items)}` : "";
    const words = one.choices?.length > 1 ? one.choices.map(typeName) : types.map((type) => (type === "array" ? `array${item}` : type));
    const name = one.name && one.properties ? one.name : words.join(" or ");
    const limits = [one.format, one.minimum !== undefined && `≥ ${one.minimum}`, one.maximum !== undefined && `≤ ${one.maximum}`];
    return [name, one.enum && one.enum.map((word) => JSON.stringify(word)).join(" | "), ...limits].filter(Boolean).join(", ");
}

/** What lies inside a schema; deeper levels are made when they are opened, because schemas may hold themselves. */
function inside(schema) {
    const one = flat(schema);
    if (one.items && one.items !== true) return inside(one.items);
    if (!one.properties && one.additionalProperties?.$ref) return inside(one.additionalProperties);
    const entries = Object.entries(one.properties ?? {});
    if (!entries.length) return undefined;
    const list = el("dl");
    for (const [name, property] of entries) {
        const field = flat(property);
        const needed = one.required?.includes(name) && !field.optional ? "" : " (may be absent)";
        list.append(el("dt", {}, el("code", {}, name), " ", el("em", {}, typeName(property) + needed)));
        const example = field.example ?? field.examples?.[0];
        const shown = example === undefined ? [] : [" For example ", el("code", {}, JSON.stringify(example)), "."];
        const more = hasInside(property) && folded(`fields of ${name}`, () => inside(property));
        list.append(el("dd", {}, ...prose(field.description), ...shown, more || ""));
    }
    return list;
}

function hasInside(schema) {
    const one = flat(schema);
    if (one.items && one.items !== true) return hasInside(one.items);
    return Object.keys(one.properties ?? {}).length > 0 || Boolean(one.additionalProperties?.$ref);
}

function folded(title, content) {
    const details = el("details", {}, el("summary", {}, title));
    details.addEventListener("toggle", () => details.open && details.children.length === 1 && details.append(content() ?? "nothing"));
    return details;
}

/** An example of a body: what the description gives, or one made of its required fields. */
function sample(media) {
    if (media?.example !== undefined) return media.example;
    const one = flat(media?.schema ?? {});
    if (one.example !== undefined) return one.example;
    const fields = Object.entries(one.properties ?? {}).filter(([name, field]) => one.required?.includes(name) || flat(field).example !== undefined);
    return Object.fromEntries(fields.map(([name, field]) => [name, flat(field).example ?? flat(field).examples?.[0] ?? null]));
}

function curl(method, path, operation) {
    const words = ["curl -s", method === "get" ? "" : `-X ${method.toUpperCase()}`, `'${location.origin}${path}'`];
    const [type, media] = Object.entries(operation.requestBody?.content ?? {})[0] ?? [];
    if (type) words.push(`-H 'content-type: ${type}'`, type.includes("json") ? `-d '${JSON.stringify(sample(media))}'` : "--data-binary @file");
    return words.filter(Boolean).join(" ");
}

/** A form that sends a GET and shows the answer as it came. */
function trial(path, operation) {
    const answer = el("pre", { hidden: true, tabindex: "0", "aria-label": "The answer", role: "status" });
    const fields = (operation.parameters ?? []).map(resolved).filter((one) => one.in !== "header");
    const inputs = fields.map((one) => [one, el("input", { name: one.name, required: one.in === "path", placeholder: one.example ?? one.schema?.example })]);
    const send = async (event) => {
        event.preventDefault();
        let target = path;
        const query = new URLSearchParams();
        for (const [one, input] of inputs) {
            if (one.in === "path") target = target.replace(`{${one.name}}`, encodeURIComponent(input.value));
            else if (input.value) query.set(one.name, input.value);
        }
        answer.hidden = false;
        answer.textContent = "…";
        try {
            const response = await fetch(target.slice(1) + (query.size ? `?${query}` : ""));
            const text = await response.text();
            const json = (response.headers.get("content-type") ?? "").includes("json");
            answer.textContent = `${response.status} ${response.statusText}\n\n${json && text ? JSON.stringify(JSON.parse(text), null, 2) : text}`;
        } catch (error) {
            answer.textContent = `No answer: ${error.message}`;
        }
    };
    const form = el("form", { onsubmit: send }, inputs.map(([one, input]) => el("label", {}, `${one.name} `, input)), el("button", {}, "Send"));
    return [form, answer];
}

function section(path, method, operation) {
    const id = operation.operationId ?? `${method}-${path}`;
    const line = [el("span", { class: `method ${method}` }, method.toUpperCase()), el("code", {}, path)];
    const node = el("section", { id, tabindex: "-1" }, el("h3", {}, line));
    if (operation.summary) node.append(el("p", {}, prose(operation.summary)));
    if (operation.description) node.append(el("p", {}, prose(operation.description)));
    const parameters = (operation.parameters ?? []).map(resolved);
    if (parameters.length) {
        const list = el("dl");
        for (const one of parameters) {
            const place = `${one.in}, ${typeName(one.schema ?? {})}${one.required ? "" : " (may be absent)"}`;
            list.append(el("dt", {}, el("code", {}, one.name), " ", el("em", {}, place)), el("dd", {}, prose(one.description)));
        }
        node.append(el("h4", {}, "Parameters"), list);
    }
    const body = Object.entries(operation.requestBody?.content ?? {});
    if (body.length) node.append(el("h4", {}, "Body"));
    if (operation.requestBody?.description) node.append(el("p", {}, prose(operation.requestBody.description)));
    for (const [type, media] of body) {
        node.append(el("p", {}, el("code", {}, type), " ", typeName(media.schema ?? {})));
        const fields = inside(media.schema ?? {});
        if (fields) node.append(fields);
    }
    node.append(el("h4", {}, "Answers"));
    const answers = el("dl");
    for (const [status, reference] of Object.entries(operation.responses ?? {})) {
        const answer = resolved(reference);
        const [type, media] = Object.entries(answer.content ?? {})[0] ?? [];
        const schema = media?.schema;
        answers.append(el("dt", {}, el("code", {}, status === "default" ? "any other" : status), " ", el("em", {}, [type, schema && typeName(schema)].filter(Boolean).join(", "))));
        answers.append(el("dd", {}, prose(answer.description), schema && hasInside(schema) ? folded("fields", () => inside(schema)) : ""));
    }
    node.append(answers, el("h4", {}, "Call"), el("pre", { tabindex: "0", "aria-label": "Command line" }, curl(method, path, operation)));
    const streams = Object.values(operation.responses ?? {}).some((answer) => answer.content?.["text/event-stream"]);
    if (method === "get" && !streams) node.append(...trial(path, operation));
    const link = el("a", { href: `#${id}` }, line.map((part) => part.cloneNode(true)));
    const text = [method, path, operation.summary, operation.description, ...(operation.tags ?? [])].join(" ").toLowerCase();
    return { node, link, text, tag: operation.tags?.[0] ?? "other" };
}

function show() {
    $("version").textContent = description.info.version;
    const all = Object.entries(description.paths).flatMap(([path, item]) =>
        METHODS.filter((method) => item[method]).map((method) => section(path, method, item[method])));
    const groups = new Map();
    for (const one of all) groups.set(one.tag, [...(groups.get(one.tag) ?? []), one]);
    $("paths").replaceChildren(el("p", {}, prose(description.info.description)));
    const headings = [];
    for (const [tag, members] of groups) {
        const heading = el("h2", {}, tag);
        headings.push([heading, members]);
        $("index").append(heading, ...members.map((one) => one.link));
        $("paths").append(...members.map((one) => one.node));
    }
    const ordered = [...groups.values()].flat();
    const filter = () => {
        const words = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
        for (const one of ordered) one.node.hidden = one.link.hidden = !words.every((word) => one.text.includes(word));
        for (const [heading, members] of headings) heading.hidden = members.every((one) => one.node.hidden);
    };
    $("filter").addEventListener("input", filter);
    const current = () => ordered.findIndex((one) => location.hash === `#${one.node.id}`);
    const mark = () => ordered.forEach((one, index) => (index === current() ? one.link.setAttribute("aria-current", "true") : one.link.removeAttribute("aria-current")));
    const go = (step) => {
        const shown = ordered.filter((one) => !one.node.hidden);
        const place = shown.indexOf(ordered[current()]);
        const next = shown[Math.min(Math.max(place + step, 0), shown.length - 1)];
        if (!next) return;
        location.hash = next.node.id;
        next.node.focus({ preventScroll: true });
    };
    addEventListener("hashchange", mark);
    addEventListener("keydown", (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        if (event.key === "Escape") { $("filter").value = ""; filter(); $("filter").blur(); }
        if (event.target.closest("input, textarea")) return;
        if (event.key === "/") { event.preventDefault(); $("filter").focus(); }
        if (event.key === "j") go(1);
        if (event.key === "k") go(-1);
        if (event.key === "t") theme();
    });
    // What the address names did not exist when the page was opened.
    if (location.hash) document.getElementById(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
    mark();
}

function theme(wanted) {
    const root = document.documentElement;
    const next = wanted ?? THEMES[(THEMES.indexOf(root.dataset.theme ?? "system") + 1) % THEMES.length];
    root.dataset.theme = next;
    $("theme").querySelector("span").textContent = next;
    localStorage.setItem("theme", next);
}

$("theme").addEventListener("click", () => theme());
theme(THEMES.includes(localStorage.getItem("theme")) ? localStorage.getItem("theme") : "system");
try {
    const response = await fetch("openapi.json");
    if (!response.ok) throw new Error(`status ${response.status}`);
    description = await response.json();
    show();
} catch (error) {
    $("state").textContent = `The description could not be read: ${error.message}. openapi.yaml says the same.`;
}
