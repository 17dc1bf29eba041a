// A report is the page with all answers inside of its document: there is no service behind it.

/** `{kind, id, command, answers, …}`; null on the page of a service. */
export const REPORT = JSON.parse(document.getElementById('report')?.textContent ?? 'null');
