/* A plugin of QEMU (qemu-user 7.2 or later) that counts the instructions of a 64-bit Arm program by their kind; written to the
   standard error at its end as lines `COUNT KIND`. See instructions.py. Without QEMU's header, which Debian does not package. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef uint64_t qemu_plugin_id_t;
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
char *qemu_plugin_insn_disas(const struct qemu_plugin_insn *);
void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *, int, void *, uint64_t);
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, struct qemu_plugin_tb *));
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, void *), void *);
int qemu_plugin_version = 1;

enum kind { F32_FUSED, F32, F64_FUSED, F64, SCALAR_FLOAT, MEMORY, VECTOR, INTEGER, KINDS };
static const char *const names[KINDS] = {
    "f32 fused multiply-add", "other f32 vector arithmetic", "f64 fused multiply-add", "other f64 vector arithmetic",
    "scalar float",           "vector loads and stores",     "other vector",           "integer, scalar, branches"};

/* A block of instructions, and its number of executions. */
struct block {
    struct block *next;
    uint64_t runs;
    uint64_t counts[KINDS];
};
static struct block *blocks;

/* Returns the kind of a disassembled instruction such as "fmla v0.4s, v1.4s, v2.s[0]". */
static enum kind kind_of(const char *text) {
    char name[16] = "", rest[64] = "";
    sscanf(text, "%15s %63[^\n]", name, rest);
    int four = strstr(rest, ".4s") != NULL, two = strstr(rest, ".2d") != NULL;
    int is_vector = strchr("vqds", rest[0]) != NULL && rest[1] >= '0' && rest[1] <= '9';
    is_vector |= rest[0] == '{';
    if (strncmp(name, "ld", 2) == 0 || strncmp(name, "st", 2) == 0) return is_vector ? MEMORY : INTEGER;
    if (name[0] == 'f' && (four || two)) {
        if (strcmp(name, "fmla") == 0 || strcmp(name, "fmls") == 0) return four ? F32_FUSED : F64_FUSED;
        if (strcmp(name, "fmul") == 0 || strcmp(name, "fadd") == 0 || strcmp(name, "fsub") == 0) return four ? F32 : F64;
        return VECTOR;
    }
    if (name[0] == 'f' && (rest[0] == 's' || rest[0] == 'd') && strcmp(name, "fmov") != 0) return SCALAR_FLOAT;
    return is_vector ? VECTOR : INTEGER;
}

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *tb) {
    (void)id;
    struct block *block = calloc(1, sizeof *block);
    if (block == NULL) abort();
    size_t count = qemu_plugin_tb_n_insns(tb);
    for (size_t i = 0; i < count; ++i) {
        char *text = qemu_plugin_insn_disas(qemu_plugin_tb_get_insn(tb, i));
        ++block->counts[text == NULL ? INTEGER : kind_of(text)];
        free(text);
    }
    block->next = blocks;
    blocks = block;
    /* 0: adds to a counter without a call; exact for a single-threaded program. */
    qemu_plugin_register_vcpu_tb_exec_inline(tb, 0, &block->runs, 1);
}

static void ended(qemu_plugin_id_t id, void *unused) {
    (void)id;
    (void)unused;
    uint64_t sums[KINDS] = {0};
    for (const struct block *block = blocks; block != NULL; block = block->next) {
        for (int i = 0; i < KINDS; ++i) sums[i] += block->runs * block->counts[i];
    }
    for (int i = 0; i < KINDS; ++i) fprintf(stderr, "%llu %s\n", (unsigned long long)sums[i], names[i]);
}

int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int count, char **arguments) {
    (void)info;
    (void)count;
    (void)arguments;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, ended, NULL);
    return 0;
}
