/* SPDX-License-Identifier: MIT */
/*
 * A plugin of QEMU (API 1; the prototypes are those of its qemu-plugin.h, which Debian does not pack): instructions
 * executed between two calls of marking functions, the fewest and the most of all pairs since the last report.
 * Arguments: begin=ADDRESS,end=ADDRESS,report=ADDRESS,out=FILE. A line of the file: pairs, fewest, most.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct qemu_plugin_tb;
typedef uint64_t plugin_id;
typedef void (*translated)(plugin_id, struct qemu_plugin_tb *);
typedef void (*executed)(unsigned int, void *);
void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, translated);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *, executed, int flags, void *);
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *, int operation, void *, uint64_t);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
uint64_t qemu_plugin_tb_vaddr(const struct qemu_plugin_tb *);
__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { ADD = 0 }; /* the operation that QEMU itself does where a block is executed, without a call */
static uint64_t marks[3], executed_so_far, at_begin, fewest = UINT64_MAX, most, pairs;
static FILE *out;

static void mark(unsigned int vcpu, void *which)
{
    (void)vcpu;
    switch ((int)(intptr_t)which) {
    case 0:
        at_begin = executed_so_far;
        break;
    case 1: {
        const uint64_t count = executed_so_far - at_begin;
        fewest = count < fewest ? count : fewest;
        most = count > most ? count : most;
        ++pairs;
        break;
    }
    default:
        fprintf(out, "%llu %llu %llu\n", (unsigned long long)pairs, (unsigned long long)fewest,
            (unsigned long long)most);
        fflush(out);
        fewest = UINT64_MAX;
        most = pairs = 0;
    }
}

static void translate(plugin_id id, struct qemu_plugin_tb *tb)
{
    (void)id;
    for (intptr_t k = 0; k < 3; ++k) {
        if (qemu_plugin_tb_vaddr(tb) == marks[k]) {
            qemu_plugin_register_vcpu_tb_exec_cb(tb, mark, 0, (void *)k);
            return;
        }
    }
    qemu_plugin_register_vcpu_tb_exec_inline(tb, ADD, &executed_so_far, qemu_plugin_tb_n_insns(tb));
}

__attribute__((visibility("default"))) int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv)
{
    static const char *const names[3] = {"begin=", "end=", "report="};
    (void)info;
    for (int k = 0; k < argc; ++k) {
        for (int n = 0; n < 3; ++n) {
            if (strncmp(argv[k], names[n], strlen(names[n])) == 0) {
                marks[n] = strtoull(argv[k] + strlen(names[n]), NULL, 0);
            }
        }
        if (strncmp(argv[k], "out=", 4) == 0) {
            out = fopen(argv[k] + 4, "w");
        }
    }
    if (out == NULL) {
        return 1;
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    return 0;
}
