// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_LOG_FILE_H
#define FRI_CLIENT_LOG_FILE_H

#include <cstddef>
#include <string>

/*
 * A CSV file that is never overwritten, and that counts the rows on the disk. After the first failure to write nothing
 * more is written: the file ends with its last whole row.
 */
class LogFile {
public:
    LogFile();
    ~LogFile();

    /* Create a file; a path that exists is refused unless it is a device or a pipe. Throws std::runtime_error. */
    void create(const std::string &path);

    /* Whether to keep the file; else the destructor removes the one that create made (it does by default). */
    void keep(bool keep) { keep_ = keep; }

    bool is_open() const { return file_ >= 0; }

    /* Whether this is the same file as the one at a path. */
    bool same(const std::string &path) const;

    /* Append text to the row. */
    void append(const char *format, ...) __attribute__((format(printf, 2, 3)));

    /* End the row; write if much has gathered. */
    void end_row();

    /* Write what has gathered. */
    void flush();

    /* Write the buffered text and close; return 0, or errno of the first failure. */
    int close();

    unsigned long long rows() const { return rows_; } /* on the disk, the header among them */
    int error() const { return error_; }              /* errno of the first failure; 0: none */

private:
    LogFile(const LogFile &);
    LogFile &operator=(const LogFile &);

    enum { CAPACITY = 1 << 17, ROOM = 1 << 12 };

    std::string path_;
    int file_;
    bool made_, keep_, regular_; /* by create; for good; neither a device nor a pipe */
    std::size_t size_; /* bytes in buffer_ */
    unsigned long long rows_;
    int error_;
    long long end_; /* [bytes] of the last whole row in the file */
    char buffer_[CAPACITY];
};

#endif
